"""What pairs of views tell of the robots' calibrations."""
