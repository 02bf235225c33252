"""`robot-agent topics`: what a bag or a robot has."""
