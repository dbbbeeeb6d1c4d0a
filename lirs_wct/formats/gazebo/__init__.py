"""Gazebo's files: SDF, model package, heightmap."""
