"""The pose graph of the fleet, and what to ask the operator."""
