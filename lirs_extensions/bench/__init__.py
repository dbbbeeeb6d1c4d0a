"""The benchmark: fixed sets of tasks, the policies that run on them, and their scores."""

UPPER_BOUND = "astar"
"""Policy that plans on the true map; no other one is expected to do better."""
