"""Puts the processes on a machine."""
