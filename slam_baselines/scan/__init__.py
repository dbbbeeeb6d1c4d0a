"""A scan in the leveled base frame."""
