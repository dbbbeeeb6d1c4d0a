"""Many runs: the cells of an experiment, engines that run them, and going on where one was interrupted."""
