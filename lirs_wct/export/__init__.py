"""Files of a world: MJCF, Gazebo package, meshes."""
