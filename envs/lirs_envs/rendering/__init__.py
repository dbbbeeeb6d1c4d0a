"""Rendering: cameras through OpenGL, MuJoCo's viewer, and a map without OpenGL."""
