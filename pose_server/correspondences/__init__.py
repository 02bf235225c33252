"""The operator's work: validated, kept, restored."""
