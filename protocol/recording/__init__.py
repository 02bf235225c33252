"""What was said on the wire, kept in a file."""
