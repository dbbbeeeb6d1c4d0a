"""Every reader answers any bytes with a value or a WctError; `benchmarks/fuzz_atheris.py` searches longer."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.benchmark_modules import load_benchmark

fuzz = load_benchmark("fuzz_atheris")
mutate = load_benchmark("fuzz_inputs").mutate
ANY = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    found: dict[str, Path] = fuzz.write_reader_seeds(tmp_path_factory.mktemp("seeds") / "files")
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.READERS)
def test_a_reader_ends_in_a_value_or_a_wct_error(seeds: dict[str, Path], tmp_path: Path, name: str) -> None:
    valid = seeds[name].read_bytes()
    fuzz.READERS[name].read(seeds[name])  # else the mutations are of a file that is refused anyway
    zipped = seeds[name].suffix == ".gz"
    inside = gzip.decompress(valid) if zipped else valid
    target = seeds[name].with_name(
        "damaged" + "".join(seeds[name].suffixes[-2:] if zipped else seeds[name].suffixes)
    )

    @ANY
    @given(st.binary(max_size=300) | st.integers(0, 2**32))
    def holds(damage: bytes | int) -> None:
        if isinstance(damage, int):
            damage = mutate(inside, np.random.default_rng(damage), text=damage % 2 == 0)[1]
        fuzz.read_bytes(
            name, target, gzip.compress(damage, 1) if zipped and damage[:1] != b"\x1f" else damage
        )

    holds()
