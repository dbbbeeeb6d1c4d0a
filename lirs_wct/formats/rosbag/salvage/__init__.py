"""Bags without index, or whose recorder died: the whole messages that their files still hold."""
