"""The values that flow: poses, scans, grids, height fields, meshes, walls, trajectories."""
