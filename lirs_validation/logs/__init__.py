"""Mapping of real logs: log, mapper and seed give map, trajectory and record."""
