"""GMapping as its original behaves: OpenSLAM's program, planar, with its published defaults."""
