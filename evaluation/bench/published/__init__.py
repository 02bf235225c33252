"""Benchmarks that others publish: their folders as fleets, and what papers report of them."""
