"""Twin test: a log's sensors against the simulated ones, and their fitted noise."""
