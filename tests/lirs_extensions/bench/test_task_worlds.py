"""Worlds of tasks: made alike each time, or found by their content wherever they lie."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.bench.tasks import FileSpec, WorldSpec, read_world, task_set
from lirs_wct.errors import ConfigError, SourceError

YAML = (
    "image: plan.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n"
    "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
)


def file_spec(path: Path) -> FileSpec:
    content = path.read_bytes()
    return FileSpec(
        sha256=hashlib.sha256(content).hexdigest(), size=len(content), origin=f"some/where/{path.name}"
    )


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder with a laser map, under another name than the maker's and with other files around it."""
    folder = tmp_path / "data" / "deep"
    folder.mkdir(parents=True)
    cells = np.full((60, 80), 254, np.uint8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 0
    (folder / "plan.pgm").write_bytes(b"P5\n80 60\n255\n" + cells.tobytes())
    (folder / "renamed.yaml").write_text(YAML)
    (folder / "other.yaml").write_text(YAML.replace("0.05", "0.10"))
    return tmp_path / "data"


def test_a_map_is_found_by_its_content(data: Path) -> None:
    files = (file_spec(data / "deep" / "renamed.yaml"), file_spec(data / "deep" / "plan.pgm"))
    world = WorldSpec(name="plan", maker="files", files=files).world(data)
    assert world.surface.size == pytest.approx((4.0, 3.0))


def test_a_missing_file_is_named_by_origin_and_content(data: Path) -> None:
    files = (FileSpec(sha256="ab" * 32, size=124, origin="some/where/depot.yaml"),)
    spec = WorldSpec(name="depot", maker="files", files=files)
    with pytest.raises(
        SourceError, match=r"depot: no --data folder is given: some/where/depot.yaml \(sha256 abab"
    ):
        spec.world(None)
    with pytest.raises(SourceError, match=r"data does not hold it: some/where/depot\.yaml"):
        spec.world(data)


def test_generated_worlds_are_the_same_each_time() -> None:
    for set_name in ("hills", "generated"):
        world = next(t.world for t in task_set(set_name).tasks if t.world is not None and not t.world.files)
        again = read_world(world.name, world.describe())
        assert again == world
        assert np.array_equal(world.world(None).surface.z, again.world(None).surface.z)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"maker": "natural", "kind": "alps", "seed": 1}, "unknown natural terrain 'alps'"),
        ({"maker": "bundled", "source": "hard"}, "unknown bundled world 'hard'"),
        ({"maker": "floor plan", "sed": 1}, "world 'w': "),
    ],
)
def test_a_maker_says_what_it_does_not_know(entry: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_world("w", entry).world(None)
