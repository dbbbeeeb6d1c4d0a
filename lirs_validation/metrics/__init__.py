"""Metrics of a run: errors of the trajectory, agreement of the map."""
