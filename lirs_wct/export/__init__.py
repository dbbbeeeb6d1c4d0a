"""A world becomes files: MJCF, Gazebo package."""
