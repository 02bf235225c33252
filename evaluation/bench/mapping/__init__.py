"""Whether a fleet's map is where the place is."""
