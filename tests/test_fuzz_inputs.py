"""A small fixed sample of damaged inputs; `benchmarks/fuzz_inputs.py` runs more."""

import subprocess
import sys
from pathlib import Path

import pytest

HARNESS = Path(__file__).parents[1] / "benchmarks" / "fuzz_inputs.py"
KINDS = "gray8_png,gray8_jpg,float_tif,asc,vrt,map_yaml,mesh_hill_dae,mesh_binary_stl,world_json,task_set"


@pytest.mark.slow
def test_damaged_inputs_end_in_one_clear_line() -> None:
    # In a process of its own: it forks, and the tests' process has threads.
    done = subprocess.run(
        [sys.executable, HARNESS, "--count", "30", "--seed", "5", "--kinds", KINDS],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "inputs: 30, broken demands: 0" in done.stdout
