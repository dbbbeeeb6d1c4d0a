"""One added field of a run's options is an axis, an option, a control and a documented attribute."""

from dataclasses import dataclass
from typing import Annotated, Any

import pytest
from click.testing import CliRunner

from lirs_validation.cli.command import Command
from lirs_validation.config import RUN_AXES, RunConfig
from lirs_validation.sweep.tasks import cross
from lirs_wct.errors import ConfigError
from lirs_wct.option import documented, option, within
from tests.lirs_validation.records import entry


@documented
@dataclass(frozen=True, kw_only=True)
class Foggy(RunConfig):
    """A run in fog."""

    fog: int = option(0, "Density of the fog.", axis=True, metavar="N,N", check=within("[0, 9]"))


def test_one_field_is_an_axis_of_the_command_line() -> None:
    heard: dict[str, Any] = {}

    def probe(run: Annotated[dict[str, Any], Foggy]) -> None:
        """Listen."""
        heard.update(run)

    command = Command("probe", probe)
    result = CliRunner().invoke(command, ["--fog", "1-3", "--mapper", "hector"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert heard == {"fog": (1, 2, 3), "mapper": ("hector",)}
    assert "Density of the fog." in CliRunner().invoke(command, ["--help"]).output
    configs = cross("simple", kind=Foggy, **heard)
    assert [config.fog for config in configs if isinstance(config, Foggy)] == [1, 2, 3]
    assert len({config.digest for config in configs}) == 3
    with pytest.raises(ConfigError, match=r"fog must be within \[0, 9\], got 12"):
        cross("simple", kind=Foggy, fog=(1, 12))


def test_every_axis_distinguishes_groups_of_runs() -> None:
    from lirs_validation.analysis.compare import FIELDS, RunGroup

    assert set(RUN_AXES) - {"seed"} <= set(FIELDS)
    changed = {
        "robot": "jackal",
        "mapper": "gmapping",
        "terrain": "mesh",
        "rays": "mujoco",
        "lidar": "utm30lx",
    }
    changed |= {"attitude": "none", "driver": "frontier", "actors": 3, "odometry_noise": 0.5}
    changed |= {"scan_time": "rolling", "noise": "datasheet", "parameters": "map_resolution=0.1"}
    changed |= {"speed": 0.5, "turn_rate": 0.5, "reversing": 0.5}
    assert set(changed) == set(RUN_AXES) - {"seed"}
    for name, value in changed.items():
        config = entry("simple")["config"] | {name: value}
        assert RunGroup.of(entry("simple") | {"config": config}) != RunGroup.of(entry("simple")), name
