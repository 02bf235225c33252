"""Malformed input on every key that any process of a fleet subscribes to."""
