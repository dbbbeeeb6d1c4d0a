"""Simultaneous localization and mapping: one folder per method, the parts that they share beside them."""
