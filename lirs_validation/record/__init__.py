"""The run record: what was run, metrics, provenance; its schema and the catalog of metrics."""
