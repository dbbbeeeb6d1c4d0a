"""Collision validation (the paper's III-D): robots driven at random, every contact evaluated."""
