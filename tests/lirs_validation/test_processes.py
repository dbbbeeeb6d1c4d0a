"""Ctrl-C becomes a KeyboardInterrupt, but not inside LLVM's callbacks."""

import signal
import time
from collections.abc import Iterator

import pytest

from lirs_validation.processes import interrupt_after, raise_interrupts


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_waits_for_the_end_of_a_callback() -> None:
    """A build that was interrupted while a kernel was read from the cache ended with signal 11."""

    def _raw_object_cache_getbuffer() -> str:
        signal.raise_signal(signal.SIGINT)
        return "whole"

    raise_interrupts()
    assert _raw_object_cache_getbuffer() == "whole"
    with pytest.raises(KeyboardInterrupt):
        time.sleep(10)


def test_ctrl_c_is_not_lost_in_a_destructor() -> None:
    class Interrupted:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    def drop_it_and_go_on() -> None:
        Interrupted()
        time.sleep(10)

    raise_interrupts()
    with pytest.raises(KeyboardInterrupt):
        drop_it_and_go_on()


def test_ctrl_c_interrupts_at_once_elsewhere() -> None:
    raise_interrupts()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_process_that_ignores_ctrl_c_goes_on_to_do_so() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise_interrupts()
    signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_an_alarm_interrupts_only_a_block_that_lasts_longer() -> None:
    before = signal.getsignal(signal.SIGALRM)
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt), interrupt_after(0.05):
        time.sleep(10)
    assert time.monotonic() - begun < 5
    with interrupt_after(0.05):
        pass
    time.sleep(0.1)
    assert signal.getsignal(signal.SIGALRM) is before
