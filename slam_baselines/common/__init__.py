"""Planar poses and small matrices by the array."""
