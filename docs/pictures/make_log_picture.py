"""Draw the picture of docs/from_log_to_world.md: log -> map -> world -> simulated run in it.

python docs/pictures/make_log_picture.py LOG  # writes out/log_to_world.png
python docs/pictures/make_log_picture.py LOG -o docs/pictures/log_to_world.png  # in place of the tracked one
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from lirs_validation import resolve_source, validate
from lirs_wct import BuildOptions
from lirs_wct.drawing.canvas import BLUE, VERMILLION, Canvas, new_figure, title
from lirs_wct.drawing.pictures import block_picture
from lirs_wct.formats.drive_files import read_tum
from lirs_wct.formats.map_server import read_map


def main() -> None:
    """Map a log, drive a Husky through the world made of it, and draw both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", help="CARMEN log")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/log_to_world.png"))
    given = parser.parse_args()
    with TemporaryDirectory() as out:
        source = Path(resolve_source(given.log, BuildOptions(), Path(out)))
        grid, path = read_map(source), read_tum(source.with_name("estimate.tum"))
        run = validate(source, seconds=120, seed=1)
    truth, estimate, _ = run.log.trajectories()
    canvas = Canvas.over(run.world.surface.bounds)
    figure = new_figure(9.0, 2.9)
    mapped, world, built = figure.subplots(1, 3, gridspec_kw={"width_ratios": (1, 1.5, 1)})
    mapped.imshow(canvas.grid_picture(grid), extent=canvas.extent, interpolation="antialiased")
    mapped.plot(*path.xy.T, color=VERMILLION, linewidth=0.6)
    title(mapped, "A real log is mapped ...")
    world.imshow(block_picture(run.world), interpolation="antialiased")
    title(world, "... its map becomes a world ...")
    built.imshow(canvas.grid_picture(run.maps.built), extent=canvas.extent, interpolation="antialiased")
    built.plot(*truth.xy.T, color=BLUE, linewidth=1.8)
    built.plot(*estimate.xy.T, color=VERMILLION, linewidth=0.7)
    title(built, "... that a simulated Husky maps")
    for axes in (mapped, world, built):
        axes.set_axis_off()
        axes.set_anchor("S")
    given.output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
