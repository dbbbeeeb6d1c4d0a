"""Wrappers of the environments: what a mapper makes of the scans, and a difficulty that follows success."""
