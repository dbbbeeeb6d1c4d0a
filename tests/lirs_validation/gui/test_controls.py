"""Every option of `build` has a control, and untouched controls say what the command line's defaults say."""

from dataclasses import fields
from typing import Any

import pytest

from lirs_validation.config import RunConfig
from lirs_validation.gui.controls import controls
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.sources.source import BuildOptions, SourceKind


def read_controls(values: dict[str, Any]) -> BuildOptions:
    return BuildOptions(
        **{c.name: c.read(values[c.name]) for c in controls(BuildOptions) if c.name in values}
    )


def test_every_option_has_one_control() -> None:
    assert [c.name for c in controls(BuildOptions)] == [f.name for f in fields(BuildOptions)]


def test_untouched_controls_are_the_defaults() -> None:
    assert read_controls({c.name: c.initial for c in controls(BuildOptions)}) == BuildOptions()


def test_choices_name_their_defaults() -> None:
    every = (*controls(BuildOptions), *controls(RunConfig))
    named = {c.name: c.initial for c in every if c.kind == "choice"}
    assert all(named.values())
    assert (named["lidar"], named["up"], named["denoise"]) == ("the robot's own", "the file's", "none")


@pytest.mark.parametrize(
    ("name", "given", "meant"),
    [
        ("size", "40,30", (40.0, 30.0)),
        ("z_scale", 2.0, 2.0),
        ("scale", "2", (2.0, 2.0, 2.0)),
        ("invert", True, True),
        ("crop", "1,2,30,40", (1, 2, 30, 40)),
        ("smoothing", 1.5, 1.5),
        ("start", "1,2", Pose2(1, 2)),
        ("unknown", "hole", "hole"),
        ("speckle", "3", 3),
    ],
)
def test_a_control_says_what_it_shows(name: str, given: Any, meant: Any) -> None:
    found = read_controls({name: given})
    assert getattr(found, name) == meant
    assert found == BuildOptions(**{name: meant})


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("height", "tall", "height must be a number, got 'tall'"),
        ("speckle", "1.5", "speckle must be a whole number"),
        ("height", "nan", "height must be a finite number above 0"),
        ("crop", "1,2", "crop must be X,Y,W,H"),
        ("size", "a", r"size must be W\[,H\]"),
    ],
)
def test_what_no_option_is(name: str, given: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_controls({name: given})


def test_the_papers_controls_have_the_papers_names() -> None:
    names = {"color inverse", "smoothing", "sharpness", "z axis scale", "grayscale", "scale", "x axis rotate"}
    assert names <= {c.title for c in controls(BuildOptions)}


def test_controls_follow_the_kind_of_source() -> None:
    shown = {c.name for c in controls(BuildOptions) if c.shown_for(SourceKind.MAP)}
    assert "wall_height" in shown
    assert "smoothing" not in shown
    log = {c.name for c in controls(BuildOptions) if c.shown_for(SourceKind.LOG)}
    assert "wall_height" in log
