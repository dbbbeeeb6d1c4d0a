"""What `task_sets.py` draws: worlds, robots and numbers of tasks, set by set; no world is in two splits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lirs_extensions.bench.tasks import FileSpec, WorldSpec


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Tasks to draw in one world.

    Attributes:
        world: where.
        split: which its tasks belong to.
        robot: name.
        navigation: number of tasks.
        mapping: number of tasks.
    """

    world: WorldSpec
    split: str
    robot: str
    navigation: int
    mapping: int


FILES = {
    "maze": (
        ("829c90820d25db171a2a22d8406c0b9526f740e747acf57bcf7d899430401b7b", 108, "maze.yaml"),
        ("576afeb2bea22f225a834071480d9950c6f6569b21d84469b7cce88f001089fd", 2539, "maze.png"),
    ),
    "smoothers_world": (
        ("70f26c148b49362188f53a1f195b9edb185290052ca8693bad084855e60cf333", 123, "smoothers_world.yaml"),
        ("d4234c8a7209fd2cfd208d669b5ae188d7e63f51ea4ab57a88163ea17c3f6ef2", 90061, "smoothers_world.pgm"),
    ),
    "depot": (
        ("9749da3322f0166cd9ae97484de6fc671e3ff4705ea02e98934582afdfb89ef9", 124, "depot.yaml"),
        ("71bbac79cfc2f5db89095182bfa86b29d96b07d4ed3b7726e513ed57afffc851", 185443, "depot.pgm"),
    ),
    "willow": (
        (
            "e10d1ba93e8f204a581641a5da85d6803c89c4216e619637a2fcfe0317d290af",
            145,
            "willow-2010-02-18-0.10.yaml",
        ),
        (
            "d7644ea5eabbbc77dcb6f136774f9b159a6514151f9c411bbd6c383f592bd6e0",
            344182,
            "willow-2010-02-18-0.10.pgm",
        ),
    ),
    "apollo15": (
        (
            "ffe53e8a345baba7642cc326357dc02c710e449086da462c383143a28ca3dd50",
            27697,
            "NAC_DTM_APOLLO15_E261N0036_257x257+7472+2152.png",
        ),
    ),
    "prayag": (
        (
            "40466c9cac00ca3bd7c6b09c5d632a2c6209772497f8b28734409a9e83a9b685",
            1050747,
            "prayag_height_map.tif",
        ),
    ),
    "vrc_driving": (
        ("bbc5cc3e95b24bc65e9e1985d2dd69faf18bbb0ab6262181eae5e152b3c71ce9", 5897, "heightmap.png"),
    ),
    "moon": (("db21b6f2e9ad3f341a3cdfbdd2bc31c2b089db809962c575bcbc5f47d2d9a571", 4987, "dem_moon.tif"),),
}
"""Digest, size and name of the files that do not ship, by world; the source first."""
ORIGINS = {
    "maze": "dfki-ric/mir_robot mir_gazebo/maps",
    "smoothers_world": "ros-planning/navigation2 tools/smoother_benchmarking/maps",
    "depot": "ros-planning/navigation2 nav2_bringup/maps",
    "willow": "turtlebot/turtlebot_apps turtlebot_navigation/maps",
    "apollo15": "osrf/gazebo_models apollo15_landing_site_1000x1000/materials/textures",
    "prayag": "saiaravind19/gazebo_terrain_generator sample_worlds/prayag/textures",
    "vrc_driving": "osrf/gazebo_models vrc_driving_terrain/materials/textures",
    "moon": "gazebosim/gz-common test/data",
}
"""Repository and folder that hold them."""


MAPS = (("maze", "train"), ("smoothers_world", "validation"), ("depot", "test"), ("willow", "test"))
"""Maps of buildings among them, with their splits."""


FURTHER_PLANS = range(23, 69)
"""Seeds of floor plans for tests of navigation only: 150 generated tasks tell policies apart."""


def made(maker: str, name: str, **options: Any) -> WorldSpec:
    """Return a world that ships, or that a generator makes."""
    return WorldSpec(name=name, maker=maker, options=tuple(options.items()))


def from_files(name: str, **options: Any) -> WorldSpec:
    """Return a world of files that do not ship."""
    files = tuple(
        FileSpec(sha256=sha256, size=size, origin=f"{ORIGINS[name]}/{file}")
        for sha256, size, file in FILES[name]
    )
    return WorldSpec(name=name, maker="files", options=tuple(options.items()), files=files)


def lirs() -> list[Plan]:
    """Return the three bundled worlds, one a split."""
    worlds = (("simple", "train"), ("medium", "validation"), ("advanced", "test"))
    return [
        Plan(
            world=made("bundled", name, source=name), split=split, robot=robot, navigation=count, mapping=two
        )
        for name, split in worlds
        for robot, count, two in (("husky", 6, 2), ("jackal", 4, 2))
    ]


def hills() -> list[Plan]:
    """Return hills, dunes and a field of boulders for each split, and elevation models that do not ship."""
    plans = []
    for first, split in ((0, "train"), (10, "validation"), (20, "test")):
        for k, (kind, mapping) in enumerate((("hills", 0), ("dunes", 0), ("boulders", 4))):
            world = (
                made(kind, f"{kind}-{first + k}", seed=first + k) if mapping else _natural(kind, first + k)
            )
            robot = "husky" if k else "jackal"
            plans.append(Plan(world=world, split=split, robot=robot, navigation=4, mapping=mapping))
    for name, split in (
        ("apollo15", "train"),
        ("prayag", "validation"),
        ("vrc_driving", "test"),
        ("moon", "test"),
    ):
        plans.append(Plan(world=from_files(name), split=split, robot="husky", navigation=4, mapping=0))
    return plans


def _natural(kind: str, seed: int) -> WorldSpec:
    return made("natural", f"{kind}-{seed}", kind=kind, seed=seed)


def indoor() -> list[Plan]:
    """Return floor plans for each split, and maps of buildings that do not ship."""
    robots = ("jackal", "turtlebot2", "turtlebot3_waffle")
    plans = [
        Plan(
            world=made("floor plan", f"floor-plan-{seed}", seed=seed),
            split=split,
            robot=robots[k],
            navigation=4,
            mapping=2,
        )
        for first, split in ((0, "train"), (10, "validation"), (20, "test"))
        for k, seed in enumerate(range(first, first + 3))
    ]
    # A lidar of 30 m sees half of a hall at once: there a robot with a short one maps.
    for robot, navigation, mapping in (("jackal", 4, 0), ("turtlebot2", 0, 2)):
        for name, split in MAPS:
            plans.append(
                Plan(world=from_files(name), split=split, robot=robot, navigation=navigation, mapping=mapping)
            )
    # Last, so that the seeds of the tasks above stay.
    return plans + [
        Plan(
            world=made("floor plan", f"floor-plan-{seed}", seed=seed),
            split="test",
            robot=robots[k % len(robots)],
            navigation=3,
            mapping=0,
        )
        for k, seed in enumerate(FURTHER_PLANS)
    ]


def generated() -> list[Plan]:
    """Return courses as worlds for each split; courses to traverse are drawn apart."""
    courses = (("mazes", 0.5, 2), ("mazes", 1.0, 2), ("stones", 0.7, 0))
    return [
        Plan(
            world=made("course", f"{kind}-{first + k}", kind=kind, difficulty=difficulty, seed=first + k),
            split=split,
            robot="husky" if kind == "stones" else "jackal",
            navigation=3,
            mapping=mapping,
        )
        for first, split in ((0, "train"), (10, "validation"), (20, "test"))
        for k, (kind, difficulty, mapping) in enumerate(courses)
    ]


PLANS = {"indoor": indoor, "hills": hills, "lirs": lirs, "generated": generated}
COURSE_DIFFICULTIES = {"train": (0.25, 0.5, 0.75), "validation": (0.5, 0.75), "test": (0.5, 0.75, 1.0)}
"""Of the courses to traverse, of each kind one."""
