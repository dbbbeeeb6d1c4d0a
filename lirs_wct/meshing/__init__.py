"""A height field or walls become a closed mesh: solid, triangulation, tiles, texture."""
