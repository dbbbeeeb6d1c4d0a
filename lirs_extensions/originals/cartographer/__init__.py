"""Cartographer as in Google's program: planar, with the published defaults."""
