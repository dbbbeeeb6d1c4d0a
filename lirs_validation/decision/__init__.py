"""Decision whether a SLAM method works on a terrain, by drives and a sequential test."""
