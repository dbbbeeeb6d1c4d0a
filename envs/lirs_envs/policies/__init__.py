"""Policies that need no learning: what a learnt one is compared with."""
