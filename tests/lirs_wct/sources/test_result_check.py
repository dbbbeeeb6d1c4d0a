"""Unusual figures of a built world are named, usual ones are not."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct import BuildOptions, World, build_world
from lirs_wct.geometry import HeightField, OccupancyGrid
from lirs_wct.ground import Ground, LaserMap, Terrain
from lirs_wct.sources.build import unusual_figures
from lirs_wct.sources.laser_map import level_floor, walls_of
from lirs_wct.sources.source import SourceKind

WAVES = np.add.outer(np.sin(np.arange(40) / 5), np.cos(np.arange(60) / 7)).astype(np.float32)


def lines(ground: Ground, kind: SourceKind = SourceKind.PICTURE) -> list[str]:
    return list(unusual_figures(World("a", ground), kind))


def terrain(z: np.ndarray, cell: float = 0.5) -> Terrain:
    return Terrain(HeightField(z.astype(np.float32), (cell, cell), (0.0, 0.0)))


def laser_map(p: np.ndarray) -> LaserMap:
    grid = OccupancyGrid.from_probability(p, 0.1)
    walls = walls_of(grid, 2.5)
    return LaserMap(level_floor(walls), walls, grid)


@pytest.mark.parametrize(
    ("z", "cell", "words"),
    [
        (WAVES, 0.5, None),
        (WAVES * 0.015, 0.015, "the world is 0.885 m wide"),
        (WAVES * 0.018, 0.018, None),
        (WAVES * 1000, 1700.0, "the world is 1.003e+05 m wide"),
        (WAVES * 1000, 1690.0, None),
        (WAVES * 22, 0.5, None),
        (WAVES * 23, 0.5, "the relief of 91.9 m is 3.12 x the width of 29.5 m"),
        (WAVES * 1e-5, 0.5, "the ground is flat"),
        (WAVES * 0, 0.5, "the ground is flat, 0 m of relief"),
        (WAVES * 1e-4, 0.5, None),
    ],
)
def test_width_and_relief(z: np.ndarray, cell: float, words: str | None) -> None:
    found = lines(terrain(z, cell))
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


@pytest.mark.parametrize(("value", "side"), [(-70.0, "below"), (90.0, "above")])
@pytest.mark.parametrize("place", [np.s_[:1], np.s_[10:13, 20:30], np.s_[5, 5]])
def test_an_isolated_level(value: float, side: str, place: tuple[slice, ...]) -> None:
    z = WAVES / 2
    z[place] = value
    (found,) = [line for line in lines(terrain(z)) if "all others" in line]
    assert found.startswith(f"{int((z == value).sum())} of 2400 heights lie ")
    assert f"m {side} all others, which span " in found
    assert "--option nodata" in found


def test_steps_and_cliffs_are_no_isolated_level() -> None:
    step = np.where(np.arange(60) > 30, 5.0, 0.0) * np.ones((40, 1))
    cliff = WAVES + np.where(np.arange(60) > 30, 25.0, 0.0)
    for z in (step, cliff):
        assert lines(terrain(z)) == []


def test_walls_of_a_map() -> None:
    free = np.zeros((30, 40))
    half, most, none = free.copy(), free.copy(), np.full((30, 40), np.nan)
    half[:, :20], most[:, :21], none[:, :10] = 1.0, 1.0, 1.0
    assert lines(laser_map(half)) == []
    assert lines(laser_map(most)) == [
        "52.5% of its cells are walls, usual are above 0 and up to 50%: occupied_thresh, free_thresh, "
        "negate, mode and transparency decide"
    ]
    assert [line[:41] for line in lines(laser_map(free))] == ["0.0% of its cells are walls, usual are ab"]
    assert [line[:31] for line in lines(laser_map(none))] == ["none of its 1200 cells is free:"]


def test_a_build_says_each_line_once_with_the_path(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((9, 9), 7, np.uint8))
    with warnings.catch_warnings(record=True, action="always") as told:
        build_world(tmp_path / "flat.png", BuildOptions(size=20.0))
    assert [str(line.message)[: len(str(tmp_path)) + 29] for line in told] == [
        f"{tmp_path}/flat.png: the ground is flat"
    ]
