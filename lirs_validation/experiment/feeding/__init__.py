"""Feeding of a mapper: direct, in a thread, or in a process."""
