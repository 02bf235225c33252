"""Which pair is next, and aligning it."""
