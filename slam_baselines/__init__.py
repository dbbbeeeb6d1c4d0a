"""Simultaneous localisation and mapping: one file per method, the parts that they share beside them."""
