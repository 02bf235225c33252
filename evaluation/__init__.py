"""Measures the system against ground truth; the only place that knows it."""
