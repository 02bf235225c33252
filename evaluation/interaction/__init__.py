"""What the operator's clicks are worth: on rings of robots, on single pairs, and over time."""
