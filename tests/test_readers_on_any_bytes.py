"""Every reader answers any bytes with a value or a WctError; `benchmarks/fuzz.py` searches longer."""

import gzip
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.benchmark_modules import load_benchmark
from tests.command_line import run_command

fuzz = load_benchmark("fuzz")
ANY = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


ODD_NUMBERS = ("nan", "inf", "1e300", "-1e300", "-1", "0", "1e-300", "99999999999999999999", "", "x")
EXTREME_WORDS = (0, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def mutate(data: bytes, rng: np.random.Generator, *, text: bool) -> bytes:
    """Damage the bytes of a file at random."""
    out, place = bytearray(data), int(rng.integers(max(len(data), 1)))
    match str(rng.choice(["truncate", "flip", "noise", "empty", "double", *["special"] * 4])):
        case "truncate":
            return data[:place]
        case "noise":
            return rng.bytes(int(rng.integers(1, 4096)))
        case "empty":
            return b""
        case "double":
            return data + data
        case "flip":
            for k in rng.integers(len(out), size=int(rng.integers(1, 20))).tolist():
                out[k] ^= int(rng.integers(1, 256))
        case _ if text:  # half of the time one of the first numbers, which head most formats
            numbers = list(re.finditer(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?", data))
            if numbers := numbers[: 12 if rng.random() < 0.5 else None]:
                hit = numbers[int(rng.integers(len(numbers)))]
                out[hit.start() : hit.end()] = str(rng.choice(ODD_NUMBERS)).encode()
        case _:  # a number of 1, 2, 4 or 8 bytes in the header
            width = int(rng.choice((1, 2, 4, 8)))
            place = int(rng.integers(max(min(256, len(out)) - width, 1)))
            word = int(rng.choice(EXTREME_WORDS)) & (256**width - 1)
            out[place : place + width] = word.to_bytes(width, "little" if rng.random() < 0.5 else "big")
    return bytes(out)


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
        return mutate(inside, np.random.default_rng(seed), text=seed % 2 == 0)

    @ANY
    @given(st.binary(max_size=300) | st.integers(0, 2**32).map(mutated))
    def holds(damage: bytes) -> None:
        data = gzip.compress(damage, 1) if zipped and damage[:1] != b"\x1f" else damage
        fuzz.read_damaged(name, seeds, data)

    holds()


COMMANDS = {
    **dict.fromkeys(("dune.png", "gray8.jpg", "float.tif", "map.yaml"), ("info in/{}", "build in/{} -o out")),
    **dict.fromkeys(("hill.dae", "hill.stl"), ("info in/{}", "convert in/{} out.stl")),
    **dict.fromkeys(("dem.asc", "dem.xyz", "points.ply", "gray8.gif"), ("info in/{}",)),
    "world/world.json": ("info in/world", "build in/world -o out"),
    "run/map.yaml": ("report in/run -o r.html", "export in/run -o out"),
    "run/truth.tum": ("score in/run --trajectory in/{} -o s.json",),
    "tasks.json": ("bench straight --set in/{} -o out",),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_damaged_inputs_end_in_one_clear_line(
    name: str, seeds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for seed in range(3):
        work = tmp_path / str(seed)
        shutil.copytree(seeds, work / "in")
        damaged = mutate((seeds / name).read_bytes(), np.random.default_rng(seed), text=seed == 1)
        (work / "in" / name).write_bytes(damaged)
        monkeypatch.chdir(work)
        for command in COMMANDS[name]:
            code = run_command(*command.replace("{}", name).split())
            said = capfd.readouterr().err
            assert code in (0, 2, 3), said
            assert not re.search(
                r"Traceback|\w(?:Error|Exception)\b|libpng|TIFF(?:Read|Fetch|Open)|site-packages", said
            )
            if code == 2:
                assert re.fullmatch(r"lirs-wct: in/[^:,\s]+[:,\s].{,1000}\n", said)
                assert not any("." in path.name for path in work.glob("out/*"))
