"""What an operator's hands and eyes need, whatever shows it: commands, keys, advice, colours."""
