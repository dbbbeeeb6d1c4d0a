"""One file per format that the outside world reads or writes."""
