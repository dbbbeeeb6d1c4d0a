"""Fixtures of runs and of the command line, shared with the tests of the core."""

from tests.lirs_validation.cli.conftest import wct
from tests.lirs_validation.conftest import hills, room

__all__ = ["hills", "room", "wct"]
