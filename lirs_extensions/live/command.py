"""The command `live`: a ROS 2 system in a world."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from lirs_extensions.live.options import LiveOptions
from lirs_validation.cli.command import OneSource, common, map_logs
from lirs_validation.cli.progress import err, out, progress_bar, say
from lirs_validation.config import CLIENT, RUN_AXES, RunConfig, World
from lirs_wct.errors import ConfigError
from lirs_wct.option import option

SECONDS = 600.0
"""Simulated seconds of a live drive."""


@dataclass(frozen=True, kw_only=True)
class LiveCommand(OneSource):
    """Source and results of `live`."""

    output: Path = option(Path("out"), "Folder for the run's folder.")


@common(
    *("robot", "lidar", "seconds", "output", "middleware", "domain", "ros", "lockstep", "rate", "client"),
    *("host", "mapper", "driver"),
)
def live(
    options: LiveCommand, run: Annotated[dict[str, Any], RunConfig], live: LiveOptions, build: World
) -> None:
    """Publish a drive on ROS 2 topics, for a client that maps or drives.

    It is evaluated like any mapper. It drives by /cmd_vel unless --driver names one of our drivers, and maps
    unless --mapper does.

    Examples:
    lirs-wct live simple --robot husky --lockstep --seconds 60 -o out/
    lirs-wct live medium --driver tour --client slam_toolbox --rate 1 -o out/
    """
    from lirs_extensions.live.run import live as drive_live

    (source,), build = map_logs([options.source], build, options.output)
    given = {name: _single(name, value) for name, value in run.items()}
    given = {"seconds": SECONDS, "driver": CLIENT, "mapper": live.client, **given}
    config = RunConfig(source=source, build=build, **given)
    announce = partial(err.print, highlight=False, markup=False, soft_wrap=True)
    with progress_bar(source) as progress:
        for drive in drive_live(config, live, out=options.output, progress=progress, announce=announce):
            bridge, result = drive.bridge, drive.run
            out.print(
                f"{bridge.published} scans published; of {bridge.expected} that need an answer, "
                f"{bridge.answered} were answered in time, {bridge.late} late, {bridge.missed} not at all",
                highlight=False,
            )
            if bridge.jitter:
                late = 1e3 * sorted(bridge.jitter)[int(0.99 * len(bridge.jitter))]
                say(f"99 % of the scans came at most {late:.1f} ms late")
            say(result.folder)
            say(f"verdict: {result.verdict}")


def _single(name: str, value: Any) -> Any:
    """Return the one value of an axis."""
    if name not in RUN_AXES:
        return value
    if len(value) > 1:
        raise ConfigError(f"live is one drive: --{name.replace('_', '-')} takes one value, got {len(value)}")
    return value[0]
