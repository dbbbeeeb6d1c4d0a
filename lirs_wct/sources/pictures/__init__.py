"""Pictures as sources: gray levels or meters as heights of a terrain."""
