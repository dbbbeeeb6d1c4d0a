"""Reports: pages and tables of runs, comparisons and scores."""
