"""A picture as a source: its gray or its meters as the heights of a terrain."""
