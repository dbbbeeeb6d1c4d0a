"""A page's worker: in order, the newest of a kind, alive after errors, gone when closed."""

import threading

import pytest

pytest.importorskip("viser")
from lirs_validation.gui.page import PageWorker


def test_the_newest_of_a_kind_is_done_in_order() -> None:
    done: list[str] = []
    begun, go = threading.Event(), threading.Event()
    worker = PageWorker(lambda error: done.append(str(error)))

    def first() -> None:
        begun.set()
        assert go.wait(10)
        done.append("first")

    worker.submit("a", first)
    assert begun.wait(10)
    for k in range(5):
        worker.submit("preview", lambda k=k: done.append(f"preview {k}"))
    worker.submit("build", lambda: done.append("build"))
    end = threading.Event()
    worker.submit("end", end.set)
    go.set()
    assert end.wait(10)
    assert done == ["first", "preview 4", "build"]
    worker.close()
    assert worker.join(10)


def test_it_survives_errors_and_stops_repeating() -> None:
    errors: list[Exception] = []
    worker = PageWorker(errors.append)
    failed = threading.Event()

    def fails() -> None:
        failed.set()
        raise ValueError("no")

    worker.repeat(fails)
    assert failed.wait(10)
    done = threading.Event()
    worker.submit("next", done.set)
    assert done.wait(10)
    assert [str(e) for e in errors] == ["no"]
    worker.close()
    assert worker.join(10)


def test_jobs_come_between_the_slices_of_idle_work() -> None:
    worker, slices = PageWorker(lambda _: None), []
    enough, done = threading.Event(), threading.Event()

    def work() -> None:
        slices.append(1)
        if len(slices) > 3:
            enough.set()

    worker.repeat(work)
    assert enough.wait(10)
    worker.submit("job", done.set)
    assert done.wait(10)
    worker.repeat(None)
    ended = []
    worker.close(at_end=lambda: ended.append(True))
    assert worker.join(10)
    assert ended == [True]
    worker.submit("late", lambda: ended.append(False))
    assert ended == [True]
