"""Calibrations of stereo rigs in the files that people have, each tool's in a module of its own."""
