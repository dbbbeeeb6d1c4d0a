"""Frames of a bag: the base, its odometry, mounts that move, and two publishers of one transform."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lirs_wct.formats.rosbag.frames import Frames, Step, one_source
from lirs_wct.geometry.pose import Pose3


def message(parent: str, child: str, T: Pose3, t: float) -> Any:
    stamp = SimpleNamespace(sec=int(t), nanosec=round((t - int(t)) * 1e9))
    translation = SimpleNamespace(x=T.x, y=T.y, z=T.z)
    rotation = SimpleNamespace(w=T.qw, x=T.qx, y=T.qy, z=T.qz)
    transform = SimpleNamespace(translation=translation, rotation=rotation)
    header = SimpleNamespace(frame_id=parent, stamp=stamp)
    return SimpleNamespace(
        transforms=[SimpleNamespace(header=header, child_frame_id=child, transform=transform)]
    )


def tree(*edges: tuple[str, str, Any], n: int = 11) -> Frames:
    """Return frames; a pose of an edge is fixed, a function of time moves on /tf."""
    frames, line = Frames(), 0
    for t in range(n):
        for parent, child, pose in edges:
            if callable(pose):
                frames.add(line, message(parent, child, pose(float(t)), float(t)), static=False)
            elif t == 0:
                frames.add(line, message(parent, child, pose, 0.0), static=True)
            line += 1
    return frames


def ahead(t: float) -> Pose3:
    return Pose3.from_rpy(t, 0.0, 0.0, 0.0, 0.0, 0.1 * t)


def sway(t: float) -> Pose3:
    return Pose3.from_rpy(0.0, 0.0, 0.0, 0.02 * math.sin(t), 0.03 * math.cos(t), 0.0)


def up(t: float) -> Pose3:
    return Pose3(0.0, 0.0, 0.1 * t)


FIXED = Pose3(0.2, 0.0, 0.3)


def test_static_transforms_that_differ_are_told() -> None:
    for second, disputed in ((FIXED, set()), (Pose3(0.3, 0.0, 0.3), {"laser"}), (ahead(1.0), {"laser"})):
        frames = tree(("base_link", "laser", FIXED), ("base_link", "laser", second))
        assert frames.disputed == disputed


ON_BASE, IN_ODOM = ("base_link", "laser", FIXED), ("odom", "base_link", ahead)
FOOTPRINT = ("odom", "base_footprint", ahead)


@pytest.mark.parametrize(
    ("edges", "base", "parent"),
    [
        ([IN_ODOM, ON_BASE], "base_link", "odom"),
        ([IN_ODOM, ("base_link", "lift", up), ("lift", "laser", FIXED)], "base_link", "odom"),
        ([FOOTPRINT, ("base_footprint", "base_link", FIXED), ON_BASE], "base_footprint", "odom"),
        ([FOOTPRINT, ("base_footprint", "base_link", sway), ON_BASE], "base_link", "odom"),
        ([("map", "odom", sway), IN_ODOM, ON_BASE], "base_link", "odom"),
        ([("odom", "body", ahead), ("body", "mast", sway), ("mast", "laser", FIXED)], "body", "odom"),
        ([("r1/odom", "r1/base_link", ahead), ("r1/base_link", "laser", FIXED)], "r1/base_link", "r1/odom"),
        ([("world", "robot", ahead), ("robot", "laser", FIXED)], "robot", "world"),
    ],
)
def test_the_base_and_its_odometry(edges: list[Any], base: str, parent: str) -> None:
    frames = tree(*edges)
    assert frames.base("/laser") == base
    steps, top = frames.odometry(base)
    assert top == parent
    assert [t for _, t, _ in steps] == list(range(11))
    for _, t, T in steps:
        assert (T.x, T.yaw) == pytest.approx((t, 0.1 * t), abs=2e-3)
    assert frames.mounts(base, "laser", [2.0, 2.5]) is not None


def test_a_moving_mount_is_that_of_each_scan() -> None:
    frames = tree(("odom", "base_link", ahead), ("base_link", "lift", up), ("lift", "laser", FIXED))
    mounts = frames.mounts("base_link", "laser", [0.0, 2.25, 20.0])
    assert mounts is not None
    assert [T.z for T in mounts] == pytest.approx([0.3, 0.525, 1.3])
    still = tree(("odom", "base_link", ahead), ("base_link", "laser", lambda t: FIXED)).mounts(
        "base_link", "laser", [0.0, 3.0]
    )
    assert still[0] is still[1]
    assert frames.mounts("base_link", "elsewhere", [0.0]) is None


def test_a_transform_that_is_not_finite_is_counted() -> None:
    frames = tree(("odom", "base_link", ahead))
    frames.add(99, message("odom", "base_link", Pose3(math.nan), 5.5), static=False)
    assert frames.skipped == 1
    assert all(math.isfinite(T.x) for _, _, T in frames.odometry("base_link")[0])


def drive(rate: float, scale: float, drift: float, phase: float, noise: float = 0.0) -> list[Step]:
    rng = np.random.default_rng(2)
    stamps = np.arange(0.0, 20.0, 1 / rate) + phase
    x, y = 0.5 * scale * stamps, drift * stamps
    return [
        (0, t, Pose3(a + rng.normal(0, noise), b + rng.normal(0, noise)))
        for t, a, b in zip(stamps.tolist(), x.tolist(), y.tolist(), strict=True)
    ]


def in_order(*sources: list[Step]) -> list[Step]:
    merged = sorted((step for source in sources for step in source), key=lambda step: step[1])
    return [(k, t, T) for k, (_, t, T) in enumerate(merged)]


def length(steps: list[Step]) -> float:
    xy = np.array([(T.x, T.y) for _, _, T in steps])
    return float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())


@pytest.mark.parametrize(
    ("sources", "count"),
    [
        ([drive(50, 1.0, 0.0, 0.0)], 1),
        ([drive(50, 1.0, 0.0, 0.0, noise=0.05)], 1),
        ([drive(50, 1.0, 0.0, 0.0), drive(50, 0.9, 0.05, 0.007)], 2),
        ([drive(50, 1.0, 0.0, 0.0), drive(50, 0.9, 0.05, 0.0)], 2),
        ([drive(50, 1.0, 0.0, 0.0), drive(20, 1.2, -0.1, 0.003)], 2),
        ([drive(10, 1.0, 0.0, 0.0), drive(50, 0.9, 0.0, 0.003)], 2),
    ],
)
def test_two_publishers_of_a_transform(sources: list[list[Step]], count: int) -> None:
    steps, found = one_source(in_order(*sources))
    assert found == count
    longest = max(sources, key=len)
    if count == 1:
        assert len(steps) == len(longest)
    else:
        assert length(steps) == pytest.approx(length(longest), rel=0.15)
        assert length(in_order(*sources)) > 3 * length(steps)


def test_without_transforms_of_the_laser_the_frame_in_odom_is_the_base() -> None:
    frames = tree(("odom", "base_link", ahead))
    assert frames.base("laser") == "base_link"
    assert frames.mounts("base_link", "laser", [0.0]) is None
