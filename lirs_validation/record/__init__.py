"""Run record: config, metrics, provenance; its schema and the catalog of metrics."""
