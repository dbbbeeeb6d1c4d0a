"""Methods and programs around the core, each behind its own command or mapper name."""
