"""A height picture becomes a world: figures on the screen, Gazebo package and MuJoCo model in a folder.

python examples/build_a_world.py [PICTURE] [-o FOLDER]
python -m mujoco.viewer --mjcf=worlds/dunes/dunes.xml       # look at it
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lirs_wct import BuildOptions, World, build_world, write_package

DUNES = Path(__file__).with_name("data") / "dunes.png"


def main() -> None:
    """Build, save and load again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", nargs="?", type=Path, default=DUNES)
    parser.add_argument("-o", "--out", type=Path, default=Path("worlds"))
    given = parser.parse_args()
    world = build_world(given.picture, BuildOptions(size=30, height=2.5, max_error=0.01))
    folder = write_package(world, given.out)
    west, south, east, north = world.surface.bounds
    print(f"{world.name}: {east - west:g} x {north - south:g} m, {world.surface.z.max():.2f} m high")
    print(f"{len(world.mesh.faces)} triangles, closed: {world.mesh.is_watertight}")
    print(f"a Husky may start at {World.load(folder).spawn_poses[0]}")
    print(*sorted(path.relative_to(given.out) for path in folder.rglob("*") if path.is_file()), sep="\n")


if __name__ == "__main__":
    main()
