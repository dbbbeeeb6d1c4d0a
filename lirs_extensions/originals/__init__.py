"""SLAM methods as published, for comparison with ours."""
