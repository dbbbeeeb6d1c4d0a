"""The benchmark: fixed sets of tasks, the policies that run on them, and their scores."""
