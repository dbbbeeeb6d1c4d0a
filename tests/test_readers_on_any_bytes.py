"""Every reader answers any bytes with a value or a WctError; `benchmarks/fuzz.py` searches longer."""

import gzip
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.benchmark_modules import load_benchmark

fuzz = load_benchmark("fuzz")
ANY = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeds") / "files"
    fuzz.write_seeds(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.READERS)
def test_a_reader_ends_in_a_value_or_a_wct_error(seeds: Path, name: str) -> None:
    read, file = fuzz.READERS[name]
    read(seeds / file)  # else the mutations are of a file that is refused anyway
    valid, zipped = (seeds / file).read_bytes(), file.endswith(".gz")
    inside = gzip.decompress(valid) if zipped else valid

    def mutated(seed: int) -> bytes:
        return bytes(fuzz.mutate(inside, np.random.default_rng(seed), text=seed % 2 == 0)[1])

    @ANY
    @given(st.binary(max_size=300) | st.integers(0, 2**32).map(mutated))
    def holds(damage: bytes) -> None:
        data = gzip.compress(damage, 1) if zipped and damage[:1] != b"\x1f" else damage
        fuzz.read_damaged(name, seeds, data)

    holds()


HARNESS = Path(__file__).parents[1] / "benchmarks" / "fuzz.py"
KINDS = "gray8_png,gray8_jpg,float_tif,asc,xyz,map_yaml,mesh_hill_dae,mesh_binary_stl,world_json,task_set"


@pytest.mark.slow
def test_damaged_inputs_end_in_one_clear_line() -> None:
    # In a process of its own: it forks, and the tests' process has threads.
    done = subprocess.run(
        [sys.executable, HARNESS, "inputs", "--count", "30", "--seed", "5", "--names", KINDS],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "inputs: 30, broken demands: 0" in done.stdout
