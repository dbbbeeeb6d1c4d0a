"""Pictures of worlds, maps, scans and paths: no OpenGL, no pyplot."""
