"""Draw the pictures of the gallery and the tutorial: worlds, robots, one run; each below 150 kB.

python docs/pictures/make_gallery.py                       # writes worlds.png, robots.png, run.jpg to out/
python docs/pictures/make_gallery.py -o docs/pictures      # in place of the tracked ones
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from lirs_envs.robots.robot import ROBOTS, Robot
from lirs_validation import validate
from lirs_wct import BuildOptions, World, build_world
from lirs_wct.arrays import ByteArray
from lirs_wct.drawing.canvas import new_figure, title
from lirs_wct.drawing.pictures import block_picture

DATA = Path(__file__).resolve().parents[2] / "examples" / "data"
DUNES = BuildOptions(size=30, height=2.5)
RUN_WIDTH = 1000
"""Pixels of the run's picture."""
MAPS = 0.535
"""Share of the run's page above its maps: what is there is the machine's speed and the table."""


def main() -> None:
    """Draw all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out"))
    output: Path = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    draw_worlds(output / "worlds.png")
    draw_robots(output / "robots.png")
    draw_run(output / "run.jpg")


def draw_worlds(path: Path) -> None:
    """Draw the bundled worlds and those of the examples' inputs, as blocks."""
    worlds: dict[str, World] = {name: build_world(name) for name in ("simple", "medium", "advanced")}
    worlds["examples/data/dunes.png"] = build_world(DATA / "dunes.png", DUNES)
    worlds["examples/data/office.yaml"] = build_world(DATA / "office.yaml")
    figure = new_figure(10.0, 5.0)
    panels = figure.subplots(2, 3).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, (name, world) in zip(panels, worlds.items(), strict=False):
        axes.imshow(block_picture(world), interpolation="antialiased")
        title(axes, name)
    figure.savefig(path, dpi=68)


def draw_robots(path: Path) -> None:
    """Draw every robot with MuJoCo's renderer."""
    figure = new_figure(10.0, 5.4)
    for axes, (name, robot) in zip(figure.subplots(2, 3).ravel(), ROBOTS.items(), strict=False):
        axes.imshow(render(robot))
        axes.set_axis_off()
        title(axes, name)
    figure.savefig(path, dpi=68)


def render(robot: Robot) -> ByteArray:
    """Return the picture of a robot that MuJoCo renders, RGB."""
    import mujoco  # after lirs_envs, which chooses OpenGL without a screen

    spec = mujoco.MjSpec.from_file(str(robot.mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(5, 5, 1), rgba=(0.75, 0.75, 0.72, 1))
    spec.worldbody.add_light(pos=(-3, -3, 5), dir=(0.5, 0.5, -0.8))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = mujoco.MjvOption()
    view.geomgroup[:] = (1, 1, 1, 0, 0, 0)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = data.body("base_link").xpos
    camera.lookat[2] += 0.1
    camera.distance, camera.azimuth, camera.elevation = 4.0 * robot.radius, 140, -25
    renderer = mujoco.Renderer(model, 480, 640)
    try:
        renderer.update_scene(data, camera=camera, scene_option=view)
        picture: ByteArray = renderer.render()
        return picture
    finally:
        renderer.close()


def draw_run(path: Path) -> None:
    """Draw the maps of the tutorial's run."""
    with TemporaryDirectory() as folder:
        run = validate("medium", mapper="hector", seconds=60, seed=1, out=folder)
        page = cv2.imread(f"{run.folder}/overview.png")
    maps = page[round(MAPS * len(page)) :]
    rows, cols = maps.shape[:2]
    smaller = cv2.resize(maps, (RUN_WIDTH, rows * RUN_WIDTH // cols), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), smaller, [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main()
