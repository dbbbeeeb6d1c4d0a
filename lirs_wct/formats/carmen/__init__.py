"""CARMEN logs: lines, laser, odometry; reading and writing."""
