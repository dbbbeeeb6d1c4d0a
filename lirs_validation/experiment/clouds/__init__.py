"""Runs of mappers that read point clouds: their guard, the clouds that are kept."""
