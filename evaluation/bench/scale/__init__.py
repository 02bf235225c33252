"""What large fleets need: neighbours found among many keyframes, pairs aligned on many machines."""
