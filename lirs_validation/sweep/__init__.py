"""Many runs: experiments at the crossings of axes, engines that run them, resuming what was interrupted."""
