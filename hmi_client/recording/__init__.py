"""An operator's session in a file, and played from it."""
