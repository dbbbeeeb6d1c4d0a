"""What a source is, and how each kind is read: picture, laser map, mesh, bundled world."""
