"""What a robot says of its own motion, and of gravity."""
