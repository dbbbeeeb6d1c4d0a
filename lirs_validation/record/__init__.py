"""The run record: config, provenance, schema, catalogue of metrics."""
