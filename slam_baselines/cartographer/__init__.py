"""Cartographer: local SLAM on submaps, loop closure, pose graph (Hess et al. 2016)."""
