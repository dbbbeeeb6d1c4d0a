"""Draw the picture of the gallery: image -> world -> map, all of it made by the project itself.

python docs/pictures/make_picture.py                                 # writes out/overview.png
python docs/pictures/make_picture.py -o docs/pictures/overview.png  # in place of the tracked one
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lirs_validation import validate
from lirs_wct.drawing.canvas import BLUE, VERMILLION, Canvas, new_figure, title
from lirs_wct.drawing.pictures import block_picture
from lirs_wct.sources.bundled import bundled_picture

WORLD = "advanced"


def main() -> None:
    """Run the advanced world with a Husky and Hector, and draw what went in and what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/overview.png"))
    given = parser.parse_args()
    run = validate(WORLD, seconds=120, seed=3)
    truth, estimate, _ = run.log.trajectories()
    canvas = Canvas.over(run.world.surface.bounds)
    figure = new_figure(9.0, 3.0)
    image, world, built = figure.subplots(1, 3, gridspec_kw={"width_ratios": (1, 1.45, 1)})
    image.imshow(bundled_picture(WORLD).pixels, cmap="gray")
    title(image, "A 16-bit picture ...")
    world.imshow(block_picture(run.world), interpolation="antialiased")
    title(world, "... becomes a world ...")
    built.imshow(canvas.grid_picture(run.maps.built), extent=canvas.extent, interpolation="antialiased")
    built.plot(*truth.xy.T, color=BLUE, linewidth=2.2)
    built.plot(*estimate.xy.T, color=VERMILLION, linewidth=0.8)
    rtf, ate = run.record.rtf["mean"], run.record.trajectory["ate_rmse"]
    title(built, f"... a Husky maps it {rtf:.0f}x faster\nthan real time, {100 * ate:.0f} cm off")
    for axes in (image, world, built):
        axes.set_axis_off()
        axes.set_anchor("S")
    given.output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
