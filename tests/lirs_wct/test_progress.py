"""Long work tells how far it has come: never backwards, never beyond the end."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.export.appearance import cube_uv
from lirs_wct.export.package import FORMATS, write_package
from lirs_wct.formats.meshes.writers import MeshPart, write_parts
from lirs_wct.geometry import HeightField
from lirs_wct.ground import Terrain
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.progress import Steps, track
from lirs_wct.world import World


@given(st.lists(st.integers(0, 9), max_size=8))
def test_tracked_items_pass_and_progress_ends_at_one(weights: list[int]) -> None:
    reported: list[tuple[str, float]] = []
    progress = lambda step, share: reported.append((step, share))  # noqa: E731
    assert list(track(weights, sum(weights), int, "a", progress)) == weights
    assert reported == sorted(reported)
    if sum(weights):
        assert reported[-1] == ("a", 1.0)


def test_steps_share_the_whole_evenly() -> None:
    told: list[tuple[str, float]] = []
    steps = Steps(4, lambda name, share: told.append((name, share)))
    within = steps.begin("a")
    within("file", 0.5)
    steps.begin("b")
    assert told == [("a", 0.0), ("a", 0.125), ("b", 0.25)]


@pytest.mark.parametrize("formats", [("stl",), ("dae", "sdf"), FORMATS])
def test_a_package_tells_each_file(formats: tuple[str, ...], tmp_path: Path) -> None:
    z = np.random.default_rng(1).random((60, 60)).astype(np.float32)
    world = World("dunes", Terrain(HeightField(z, (0.1, 0.1), (0.0, 0.0))))
    told: list[tuple[str, float]] = []
    write_package(world, tmp_path, formats=formats, progress=lambda name, share: told.append((name, share)))
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert shares[-1] <= 1.0
    assert "dunes.dae" not in [name for name, _ in told] or "dae" in formats
    assert {"world.json"} < {name for name, _ in told}


def test_a_streamed_file_ticks_tile_by_tile(tmp_path: Path) -> None:
    z = np.random.default_rng(2).random((200, 200)).astype(np.float32)
    told: list[float] = []
    part = MeshPart("ground", cube_uv(solid_mesh(HeightField(z, (0.1, 0.1), (0.0, 0.0)))))
    write_parts(tmp_path / "a.dae", [part], lambda _, share: told.append(share))
    assert len(told) > 3
    assert told == sorted(told)
    assert told[-1] == 1.0
