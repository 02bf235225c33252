"""The zenoh router as a process of its own, which watches what its rules deny."""
