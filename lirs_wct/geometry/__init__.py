"""Geometric values: poses, scans, grids, height fields, meshes, walls, trajectories."""
