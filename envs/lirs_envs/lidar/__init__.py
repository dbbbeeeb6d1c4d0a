"""The lidar, a laser range finder (LRF): presets, beam patterns, noise, ray casting."""
