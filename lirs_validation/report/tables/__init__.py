"""Tables of runs, comparisons and scores: on the screen, as Markdown, CSV and JSON."""
