"""What a page says of a world beside its picture."""

from __future__ import annotations

from lirs_validation.metrics.mesh import mesh_error
from lirs_wct.world import World

Facts = tuple[tuple[str, str], ...]
"""Names and values, to be shown as a table."""


def preview_facts(world: World) -> Facts:
    """Return what is known of a world before it is built."""
    surface = world.surface
    width, depth = surface.size
    facts = [("world", f"{world.name} ({world.kind})"), ("size", f"{width:.5g} x {depth:.5g} m")]
    walls = world.walls
    if walls is None:
        low, high = float(surface.z.min()), float(surface.z.max())
        facts.append(("heights", f"{low:.2f} to {high:.2f} m"))
    else:
        facts.append(
            ("walls", f"{int(walls.solid.sum())} cells of {walls.resolution:g} m, {walls.height:g} m high")
        )
    return tuple(facts)


def built_facts(world: World) -> Facts:
    """Return what is known of a built world: also its mesh, its error and where the meters come from."""
    surface, mesh = world.surface, world.file_mesh
    error = "exact" if world.walls is not None else f"{mesh_error(world, mesh):.4f} m at the nodes"
    grid = () if world.walls is not None else (("grid", f"{surface.shape[1]} x {surface.shape[0]} nodes"),)
    place = () if world.place is None else (("place on earth", world.place.label()),)
    return (
        *preview_facts(world),
        *place,
        *grid,
        ("meters", world.scale),
        ("triangles", f"{len(mesh.faces):,}"),
        ("mesh error", error),
        ("watertight", "yes" if mesh.is_watertight_as_written else "no"),
        ("start poses", str(len(world.spawn_poses))),
    )
