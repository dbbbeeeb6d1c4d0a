"""The command that repeats a run."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import pytest
from click.testing import CliRunner

from lirs_validation.cli.command import Command, OneSource
from lirs_validation.config import RunConfig, World
from lirs_validation.report.run_tables import command_of
from lirs_validation.sweep.tasks import cross
from lirs_wct.geometry.pose import Pose2
from lirs_wct.sources.source import BuildOptions


@pytest.mark.parametrize(
    "config",
    [
        RunConfig(source="simple"),
        RunConfig(source="a b.png", robot="jackal", mapper="m:X", lidar="lds01", terrain="mesh",
                  rays="mujoco", seconds=33.5, seed=7, wall_limit=60.0),
        RunConfig(source="x.png", build=BuildOptions(
            name="n", kind="map", size=(30.0, 20.5), window=(1.0, -2.0, 10.0), crop=(1, 2, 30, 40),
            resize=(100, 90), deterrace=True, denoise="bilateral", invert=True, grayscale=True,
            start=Pose2(1.0, -2.0, 0.1), scale=(1.0, 2.0, 3.0), texture=Path("t x.png"), max_error=0.02,
            unknown="hole", wall_height=1.25, speckle=4, rotate_x=-90.0, max_pixels=1000)),
    ],
)  # fmt: skip
def test_the_command_of_a_run_is_that_run(config: RunConfig) -> None:
    """The words go through the command line's own reading of options, and give the config back."""
    heard: dict[str, Any] = {}

    def probe(where: OneSource, run: Annotated[dict[str, Any], RunConfig], build: World) -> None:
        """Listen."""
        heard.update(source=where.source, build=build, **run)

    words = shlex.split(command_of(config))
    assert words[:2] == ["lirs-wct", "validate"]
    CliRunner().invoke(Command("validate", probe), words[2:], catch_exceptions=False, standalone_mode=False)
    assert cross(heard.pop("source"), **heard) == (config,)
