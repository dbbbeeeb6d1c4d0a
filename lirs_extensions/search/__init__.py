"""Searches: failures of a method, parameters of a mapper, sensor noise of a log."""
