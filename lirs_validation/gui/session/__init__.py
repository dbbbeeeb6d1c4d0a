"""State of a browser page without the browser: construction, drive, replay."""
