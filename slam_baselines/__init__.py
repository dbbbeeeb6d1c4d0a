"""Simultaneous localization and mapping: one folder per method, and shared parts."""
