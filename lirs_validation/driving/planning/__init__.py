"""Paths over the cells of a grid: search, clearance, coverage, smoothing."""
