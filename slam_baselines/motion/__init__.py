"""Motion of the base between scans: dead reckoning, calibration, motion filter."""
