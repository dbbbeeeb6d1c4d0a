"""A scan fitted into a map: Gauss-Newton, correlative search, branch and bound."""
