"""A picture as a source: its gray or its metres as the heights of a terrain."""
