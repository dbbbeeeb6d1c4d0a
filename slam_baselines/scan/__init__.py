"""Scans in the leveled base frame."""
