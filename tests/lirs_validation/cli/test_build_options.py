"""An option is declared once: command line, help, checks and a run's command are made from that."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from lirs_validation.cli.typer_options import with_options
from lirs_validation.config import RunConfig, SourceOptions
from lirs_validation.experiment.scenario import build_scenario
from lirs_validation.report.provenance import command_of
from lirs_wct.errors import ConfigError, LogSourceError
from lirs_wct.option import Switch, numbers, option, positive
from lirs_wct.sources.options import BuildOptions, SourceKind, without_effect


@dataclass(frozen=True, kw_only=True)
class Flooded(SourceOptions):
    """The options with two more."""

    water_level: float | None = option(
        None, "Meters of water.", panel="Water", check=positive, kinds={SourceKind.PICTURE}
    )
    current: tuple[float, float] | None = option(
        None,
        "Flow of the water.",
        metavar="U,V",
        read=numbers("U,V in meters a second", 2),
        switch=Switch(flag="--flowing", value=(1.0, 0.0), help="Eastward."),
    )


def said(*words: str) -> SourceOptions:
    heard: list[SourceOptions] = []
    app = typer.Typer()

    @app.command()
    @with_options
    def probe(source: str, mapper: str = "", *, options: Flooded) -> None:
        heard.append(options)

    CliRunner().invoke(app, ["simple", *words], catch_exceptions=False, standalone_mode=False)
    return heard[0]


def test_a_new_field_is_an_option_of_the_command_line() -> None:
    assert said("--water-level", "1.5") == Flooded(water_level=1.5)
    assert said("--current", "0.5,-1", "--size", "20") == Flooded(current=(0.5, -1.0), size=20.0)
    assert said("--flowing") == Flooded(current=(1.0, 0.0))
    assert said("--flowing", "--current", "2,3") == Flooded(current=(2.0, 3.0))


def test_a_new_field_is_in_the_help(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    app = typer.Typer()

    @app.command()
    @with_options
    def probe(source: str, *, options: Flooded) -> None: ...

    shown = CliRunner().invoke(app, ["--help"]).output
    for part in ("Water", "--water-level", "Meters of water.", "U,V", "--flowing", "--mapper"):
        assert part in shown


def test_a_new_field_is_checked_and_knows_its_sources() -> None:
    with pytest.raises(ConfigError, match=r"^water level must be a finite number above 0, got -1.0$"):
        said("--water-level", "-1")
    with pytest.raises(ConfigError, match=r"^--current must be U,V in meters a second, got '1'$"):
        said("--current", "1")
    deep = Flooded(water_level=2.0)
    assert without_effect(deep, SourceKind.PICTURE) == []
    assert without_effect(deep, SourceKind.MAP) == ["water_level"]


def test_a_new_field_is_in_the_command_of_a_run() -> None:
    command = command_of(RunConfig(source="a.png", build=Flooded(water_level=2.0, current=(1.0, 2.0))))
    assert command.endswith("--water-level 2 --current 1,2")


def test_a_command_with_a_mapper_of_its_own_keeps_the_flag() -> None:
    assert said("--mapper", "hector", "--log-mapper", "gmapping").log_mapper == "gmapping"
    assert said("--mapper", "hector") == Flooded()


def test_options_without_a_word_of_logs_make_the_same_run() -> None:
    plain: dict[str, Any] = {"size": 20.0, "invert": True}
    a = RunConfig(source="a.png", build=BuildOptions(**plain))
    b = RunConfig(source="a.png", build=SourceOptions(**plain))
    assert (a, a.digest) == (b, b.digest)


def test_a_run_in_a_log_says_who_maps_it(tmp_path: Path) -> None:
    log = tmp_path / "room.clf"
    log.write_text("")
    with pytest.raises(LogSourceError, match=r"room.clf: a log is mapped .*lirs_validation.resolve_source$"):
        build_scenario(RunConfig(source=str(log)))
