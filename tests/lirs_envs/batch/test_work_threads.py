"""Threads that share work: each piece is done once, and what raises ends the run."""

import copy
import sys
from functools import partial

import pytest

from lirs_envs.batch.work_threads import Work, WorkThreads


@pytest.fixture(params=[1, 2, 5])
def threads(request: pytest.FixtureRequest) -> WorkThreads:
    return WorkThreads(request.param)


def tree(done: list[str], name: str, depth: int) -> list[Work]:
    done.append(name)
    return [partial(tree, done, name + branch, depth - 1) for branch in "abc" if depth]


def test_each_piece_and_what_it_returns_is_done_once(threads: WorkThreads) -> None:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # Threads come between all that a thread does.
    try:
        for _ in range(600):
            done: list[str] = []
            threads.run([partial(tree, done, "x", 3)])
            assert len(done) == len(set(done)) == 1 + 3 + 9 + 27
    finally:
        sys.setswitchinterval(before)
    threads.run([])


def test_a_piece_that_raises_ends_the_run_and_not_the_threads(threads: WorkThreads) -> None:
    def fail() -> list[Work]:
        raise ValueError("no such beam")

    done: list[str] = []
    with pytest.raises(ValueError, match="no such beam"):
        threads.run([partial(tree, done, "x", 2), fail])
    done.clear()
    threads.run([partial(tree, done, "x", 1)])
    assert sorted(done) == ["x", "xa", "xb", "xc"]


@pytest.mark.parametrize("copied", [False, True])
def test_closed_or_copied_they_go_on(threads: WorkThreads, copied: bool) -> None:
    other = copy.deepcopy(threads) if copied else threads
    threads.close()
    done: list[str] = []
    other.run([partial(tree, done, "x", 1)])
    assert len(done) == 4
