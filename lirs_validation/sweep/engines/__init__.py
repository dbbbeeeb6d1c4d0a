"""Engines that perform the experiments of a sweep: serial, processes, Ray."""
