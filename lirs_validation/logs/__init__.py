"""Logs of real robots: log x mapper x seed becomes a map, a trajectory and a record."""
