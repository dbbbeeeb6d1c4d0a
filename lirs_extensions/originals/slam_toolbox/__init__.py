"""Planar slam_toolbox as in its authors' program, with the published defaults."""
