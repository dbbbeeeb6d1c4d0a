"""Falsification: search for the easiest terrain, drive and degradation on which a method fails."""
