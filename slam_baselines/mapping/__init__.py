"""Occupancy maps: growing grids, ray update, ground filter."""
