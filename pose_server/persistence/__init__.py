"""What outlives the server beside the operator's work, and what leaves and enters it as files."""
