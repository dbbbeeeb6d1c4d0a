"""Mesh files: COLLADA, STL, OBJ and the formats of trimesh."""
