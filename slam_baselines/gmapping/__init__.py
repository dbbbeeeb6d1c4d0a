"""GMapping: a Rao-Blackwellized particle filter (Grisetti et al. 2007)."""
