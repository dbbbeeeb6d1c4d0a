"""Drivers of a run: coverage tours, exploration, waypoints, replay, path following."""
