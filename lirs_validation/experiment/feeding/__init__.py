"""Feeding of a drive's mapper: in the same process, or in its own."""
