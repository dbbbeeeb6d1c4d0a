"""Mappers in a run: loaded by name, guarded, told of the attitude what the config says."""
