"""How the base moves between scans: dead reckoning, calibration, motion filter."""
