"""Robots out of bags, held to bars: topics, depths, times, and live agents beside the truth."""
