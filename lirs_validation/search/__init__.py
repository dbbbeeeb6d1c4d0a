"""Search of a space of parameters: proposals, shrinking, and trials that are kept in a file."""
