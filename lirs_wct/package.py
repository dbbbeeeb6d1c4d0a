"""A world's folder: a Gazebo model package and world, MuJoCo's MJCF, meshes, texture and `world.json`."""

from __future__ import annotations

from pathlib import Path

import cv2

from lirs_wct.errors import OutputError
from lirs_wct.files import atomic_folder
from lirs_wct.formats.collada import write_collada
from lirs_wct.formats.sdf import model_config, model_sdf, world_sdf
from lirs_wct.formats.stl import write_stl
from lirs_wct.mjcf import write_mjcf
from lirs_wct.shade import ground_texture
from lirs_wct.world import World

TEXTURES = Path("materials") / "textures"


def write_package(world: World, parent: str | Path) -> Path:
    """Write `parent/NAME/`, whole or not at all, and return it.

    Raises:
        OutputError: the folder cannot be written, or holds something that is not a built world.
    """
    folder = Path(parent) / world.name
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "world.json").is_file():
        raise OutputError(
            f"{folder}: holds files that are not a built world; choose another folder or --name"
        )
    with atomic_folder(folder) as temporary:
        texture = write_texture(world, temporary)
        (temporary / "meshes").mkdir()
        write_stl(temporary / "meshes" / f"{world.name}.stl", world.mesh)
        write_collada(temporary / "meshes" / f"{world.name}.dae", world.mesh, f"../{texture.as_posix()}")
        for file, text in (
            ("model.config", model_config(world.name)),
            ("model.sdf", model_sdf(world.name)),
            (f"{world.name}.world", world_sdf(world.name)),
        ):
            (temporary / file).write_text(text, encoding="utf-8")
        write_mjcf(world, temporary)
        world.save(temporary)
    return folder


def write_texture(world: World, folder: Path) -> Path:
    """Write the world's texture into a package and return its path inside."""
    path = TEXTURES / f"{world.name}.png"
    (folder / TEXTURES).mkdir(parents=True)
    cv2.imwrite(str(folder / path), ground_texture(world.surface, world.walls))
    return path
