"""A picture that is too large is refused in one line that says what it would take."""

import pickle
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct.errors import TooLargeError
from lirs_wct.sources import effort
from lirs_wct.sources.build import build_world
from lirs_wct.sources.effort import FULL_GRID, MAP, TERRAIN, Effort
from lirs_wct.sources.options import BuildOptions

SIDE = 300


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A picture of a ramp, and a map of the same size with its YAML file."""
    ramp = np.tile(np.linspace(0, 255, SIDE).astype(np.uint8), (SIDE, 1))
    cv2.imwrite(str(tmp_path / "ramp.png"), ramp)
    floor = np.full((SIDE, SIDE), 254, np.uint8)
    floor[:5] = 0
    cv2.imwrite(str(tmp_path / "floor.pgm"), floor)
    (tmp_path / "floor.yaml").write_text(
        "image: floor.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\nnegate: 0\n"
    )
    return tmp_path / "ramp.png"


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [("ramp.png", {}, TERRAIN), ("ramp.png", {"max_error": 0.0}, FULL_GRID), ("floor.yaml", {}, MAP)],
)
def test_a_refusal_says_memory_time_and_the_option(
    source: Path, name: str, given: dict[str, float], expected: Effort
) -> None:
    with pytest.raises(TooLargeError) as refused:
        build_world(source.with_name(name), BuildOptions(max_pixels=1000, **given))  # type: ignore[arg-type]
    said = str(refused.value)
    assert "\n" not in said
    assert (
        f"300x300 px = {SIDE**2} pixels, at most 1000 are allowed; --max-pixels {SIDE**2} allows it" in said
    )
    found = re.search(r"about (\S+) GB of memory and (\d+) s of processor time.* \(\S+ GB are free\)$", said)
    assert found is not None
    assert ("up to 0.29 GB and 3 s if it is rough" in said) == (expected is TERRAIN)
    memory, seconds = expected(SIDE**2)
    assert float(found[1]) == pytest.approx(memory / 1e9, rel=0.05)
    assert float(found[2]) == pytest.approx(seconds, abs=0.5)
    assert str(pickle.loads(pickle.dumps(refused.value))) == said
    world = build_world(source.with_name(name), BuildOptions(max_pixels=SIDE**2, **given))  # type: ignore[arg-type]
    assert world.surface is not None


@pytest.mark.parametrize(
    ("name", "helps"), [("ramp.png", "give --crop or --resize"), ("floor.yaml", "give --window")]
)
def test_a_picture_for_which_the_memory_does_not_suffice_is_refused(
    source: Path, monkeypatch: pytest.MonkeyPatch, name: str, helps: str
) -> None:
    monkeypatch.setattr(effort, "free_memory", lambda: 1e6)
    with pytest.raises(TooLargeError, match=rf"which take about .* but 0\.001 GB are free: {helps}$"):
        build_world(source.with_name(name))
    part = BuildOptions(crop=(0, 0, 50, 50)) if name == "ramp.png" else BuildOptions(window=(5, 5, 4))
    build_world(source.with_name(name), part)


def test_the_free_memory_is_that_of_the_system() -> None:
    text = Path("/proc/meminfo").read_text() if Path("/proc/meminfo").exists() else ""
    if not text:
        pytest.skip("no /proc/meminfo")
    total = 1024 * int(text.split()[1])
    assert 0.01 * total < effort.free_memory() <= total
