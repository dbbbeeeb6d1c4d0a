"""What a page of the browser is about, without the browser: construction, drive, replay."""
