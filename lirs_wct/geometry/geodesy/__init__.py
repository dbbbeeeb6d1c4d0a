"""Where a world lies on the earth: coordinate systems, pixels on the ground, the place of the origin."""
