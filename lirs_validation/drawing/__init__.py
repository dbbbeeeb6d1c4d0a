"""Pictures of worlds, runs and maps."""
