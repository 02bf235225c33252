"""The pose server: aligns pairs of robots, solves the fleet, asks the operator."""
