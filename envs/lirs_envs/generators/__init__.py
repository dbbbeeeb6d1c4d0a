"""Seeded terrains: courses of one kind of obstacle to cross, and natural ground."""
