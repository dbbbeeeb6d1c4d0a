"""Salvage of bags that are cut off or have no index: their complete messages."""
