"""Collision validation (the paper's III-D): robots driven at random into everything, every contact judged."""
