"""The laser range finder: presets, beam patterns, noise, ray casting."""
