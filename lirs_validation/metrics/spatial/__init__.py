"""Metrics of mappers that estimate poses in space: errors of the trajectory, the elevation that they map."""
