"""Lidar, wheels and inertial unit fused in space: scan-to-map registration with a motion prior."""
