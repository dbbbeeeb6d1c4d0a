"""Fixtures of runs and of the command line, shared with the tests of the core."""

from tests.lirs_validation.cli.conftest import wct
from tests.lirs_validation.conftest import brief_warm_up, hills, room

__all__ = ["brief_warm_up", "hills", "room", "wct"]
