"""Tuning: search for parameters of a mapper that suit one world or log."""
