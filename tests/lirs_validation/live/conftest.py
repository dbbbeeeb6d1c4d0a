import itertools
import os

import pytest

_counter = itertools.count()


@pytest.fixture
def domain() -> int:
    """A domain that no other worker uses; above 100, ports reach those of outgoing connections."""
    return 4 + 8 * (os.getpid() % 12) + next(_counter) % 8
