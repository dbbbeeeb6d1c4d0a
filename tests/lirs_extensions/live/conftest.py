import itertools
import os

import pytest

_counter = itertools.count()


@pytest.fixture
def domain() -> int:
    """A domain that no other worker uses; above 100, ports reach those of outgoing connections."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    return 4 + 8 * ((os.getppid() + worker) % 12) + next(_counter) % 8
