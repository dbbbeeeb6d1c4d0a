"""A point cloud as a source: its ground as a surface."""
