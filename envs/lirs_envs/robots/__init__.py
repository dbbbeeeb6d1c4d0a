"""The robots: data, MJCF files, drive and flight control, URDF."""
