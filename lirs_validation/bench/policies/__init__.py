"""The benchmark's policies: shipped ones by name, and the user's own."""
