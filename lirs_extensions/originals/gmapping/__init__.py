"""GMapping as in OpenSLAM's original program: planar, with the published defaults."""
