"""What the ranking of questions saves an operator."""
