"""One validation run: scenario, loop, evaluation, results."""
