"""Closed meshes of height fields and walls: solid, triangulation, tiles, texture."""
