"""Every command is a function of a module of this folder."""
