"""Decision whether a SLAM method works on a terrain: drives until a sequential test decides, page."""
