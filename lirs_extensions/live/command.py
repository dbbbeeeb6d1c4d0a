"""The command `live`: a ROS 2 system in a world."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lirs_extensions.live.options import LiveOptions
from lirs_validation.cli.progress import err, out, progress_bar
from lirs_validation.cli.typer_options import SOURCE_HELP, complete_source
from lirs_validation.config import CLIENT, RUN_AXES, RunConfig, SourceOptions
from lirs_wct.errors import ConfigError

if TYPE_CHECKING:
    from lirs_extensions.live.run import LiveRun

SECONDS = 600.0
"""Simulated seconds of a live drive."""
Source = Annotated[str, typer.Argument(metavar="SOURCE", help=SOURCE_HELP, autocompletion=complete_source)]
Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for the run's folder.")]


def live(
    source: Source,
    output: Output = Path("out"),
    *,
    run: Annotated[dict[str, Any], RunConfig],
    live: LiveOptions,
    options: SourceOptions,
) -> None:
    """Publish a drive on ROS 2 topics, for a client that maps or drives.

    It is evaluated like any mapper. It drives by /cmd_vel unless --driver names one of our drivers, and maps
    unless --mapper does.
    """
    from lirs_extensions.live.run import live as drive_live

    given = {name: _single(name, value) for name, value in run.items()}
    given = {"seconds": SECONDS, "driver": CLIENT, "mapper": live.client, **given}
    config = RunConfig(source=source, build=options, **given)
    with progress_bar(source, err) as progress:
        for result in drive_live(config, live, out=output, progress=progress, announce=_tell):
            _show(result)


def _single(name: str, value: Any) -> Any:
    """Return the one value of an axis.

    Raises:
        ConfigError: there are several.
    """
    if name not in RUN_AXES:
        return value
    if len(value) > 1:
        raise ConfigError(f"live is one drive: --{name.replace('_', '-')} takes one value, got {len(value)}")
    return value[0]


def _tell(line: str) -> None:
    err.print(line, highlight=False, markup=False, soft_wrap=True)


def _show(result: LiveRun) -> None:
    bridge, run = result.bridge, result.run
    out.print(
        f"{bridge.published} scans published; of {bridge.expected} that need an answer, {bridge.answered} "
        f"were answered in time, {bridge.late} late, {bridge.missed} not at all",
        highlight=False,
    )
    if bridge.jitter:
        late = 1e3 * sorted(bridge.jitter)[int(0.99 * len(bridge.jitter))]
        out.print(f"99 % of the scans came at most {late:.1f} ms late", highlight=False)
    out.print(f"{run.folder}", soft_wrap=True, highlight=False)
    out.print(f"verdict: {run.verdict}", soft_wrap=True, highlight=False, markup=False)
