"""Who drives in a run, and where: tours planned over the true ground, paths, and their pursuit."""
