"""The command `verdict`: does a SLAM method work on a terrain? Drives and a sequential test decide."""
