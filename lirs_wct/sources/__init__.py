"""Sources of worlds and their readers: picture, laser map, mesh, point cloud."""
