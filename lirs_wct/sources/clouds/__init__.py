"""Point clouds as sources: ground extraction and surface."""
