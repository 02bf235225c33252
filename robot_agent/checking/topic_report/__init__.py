"""What `robot-agent topics` says, of a bag or of a robot that runs."""
