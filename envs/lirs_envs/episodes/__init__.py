"""Episodes of N robots: options, observations, what is drawn for each, and the worlds they are in."""
