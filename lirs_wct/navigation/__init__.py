"""Traversability and spawn poses of robots."""
