"""Scan-to-map matching: Gauss-Newton, correlative search, branch and bound."""
