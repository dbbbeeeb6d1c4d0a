"""Episodes of N robots: options, observations, randomization and cached worlds."""
