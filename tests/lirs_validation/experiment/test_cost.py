"""What a run costs, and how busy the system is."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from numba import njit

from lirs_validation.experiment.cost import CostMeter, compile_timer, is_shared, load_average
from lirs_validation.processes import is_interrupt

PEAKS = """
import numpy as np
from lirs_validation.experiment.cost import CostMeter
meter = CostMeter()
before = meter.cost().peak_memory
block = np.ones(200_000_000, np.uint8)
high = meter.cost().peak_memory
del block
print(before, high, CostMeter().cost().peak_memory)
"""


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak is reset on Linux only")
def test_peak_memory_is_of_the_run_alone() -> None:
    """In a process of its own, whose memory no other test gives back meanwhile."""
    done = subprocess.run([sys.executable, "-c", PEAKS], capture_output=True, text=True, check=True)
    before, high, after = map(int, done.stdout.split())
    assert 190e6 < high - before < 400e6
    assert after < high - 150e6


def test_processor_time_is_counted_and_waiting_is_not() -> None:
    meter = CostMeter()
    time.sleep(0.2)
    waited = meter.cost().cpu_seconds
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    assert waited < 0.15
    assert 0.2 <= meter.cost().cpu_seconds < 0.6


def test_compilation_is_timed_and_all_else_is_not() -> None:
    kernel = njit(lambda x: x + 1)
    with compile_timer() as compile_seconds:
        time.sleep(0.1)
        assert compile_seconds() == 0.0
        kernel(1)
        first = compile_seconds()
        kernel(2)
    assert first > 0.0
    assert compile_seconds() == first


def test_a_load_above_the_cores_means_a_shared_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    for load, shared in ((0.4, False), (2.0, False), (2.1, True)):
        monkeypatch.setattr("os.getloadavg", lambda load=load: (load, 9.0, 9.0), raising=False)
        assert load_average() == load
        assert is_shared(load) == shared


def test_a_system_without_a_load_is_not_called_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("os.getloadavg", raising=False)
    assert load_average() is None
    assert not is_shared(None)


def test_ctrl_c_is_known_in_disguise() -> None:
    wrapped = SystemError("CPUDispatcher returned a result with an exception set")
    wrapped.__cause__ = KeyboardInterrupt()
    assert is_interrupt(wrapped)
    assert is_interrupt(KeyboardInterrupt())
    assert not is_interrupt(SystemError("something else"))
    assert not is_interrupt(ValueError("no"))
