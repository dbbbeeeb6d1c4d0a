"""The command line, `lirs-wct`: the commands, their options, and `app`, which puts them together."""
