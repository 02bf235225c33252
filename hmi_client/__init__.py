"""The operator's clients."""
