"""Mesh files: COLLADA, STL, OBJ and what trimesh reads."""
