"""Pictures of a simulation: cameras through OpenGL, MuJoCo's viewer, and a map from above without OpenGL."""
