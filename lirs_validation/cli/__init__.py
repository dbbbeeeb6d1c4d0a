"""The command line, `lirs-wct`: the commands, their options, and `app`, which puts them together."""

from lirs_validation.cli.app import main

__all__ = ["main"]
