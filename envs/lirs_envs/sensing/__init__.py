"""Odometry and inertial unit, their fusion, and all sensors of a robot together."""
