"""Sweeps: experiments at every combination of options, engines that run them, resumption."""
