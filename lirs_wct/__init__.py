"""LIRS-WCT: a picture or a laser map becomes a World."""
