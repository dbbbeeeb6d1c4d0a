"""The command line, `lirs-wct`: one theme of commands a file, put together in `app`."""

from lirs_validation.cli.app import main

__all__ = ["main"]
