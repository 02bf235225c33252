"""A site that is kept in a file, and shown in others' viewers."""
