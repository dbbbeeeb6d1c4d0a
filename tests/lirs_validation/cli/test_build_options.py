"""An option is declared once: command line, help, checks and a run's command are made from that."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import click
import pytest
from click.testing import CliRunner

from lirs_validation.cli.command import Command, OneSource
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import build_scenario
from lirs_validation.report.run_tables import command_of
from lirs_wct.errors import ConfigError, LogSourceError
from lirs_wct.option import option, positive
from lirs_wct.sources.source import BuildOptions, Source, SourceKind, warn_without_effect


@dataclass(frozen=True, kw_only=True)
class Flooded(BuildOptions):
    """The options with some more."""

    water_level: float | None = option(
        None, "Meters of water.", panel="Water", check=positive, kinds={SourceKind.PICTURE}
    )
    current: tuple[float, float] | None = option(None, "Flow of the water.", metavar="U,V")
    salt: Literal["none", "some"] = option("none", "Salt in the water.", rare=True)
    waves: bool = option(False, "Whether there are waves.", rare=True)


def said(*words: str) -> Flooded:
    heard: list[Flooded] = []

    def probe(where: OneSource, options: Flooded) -> None:
        """Listen."""
        heard.append(options)

    CliRunner().invoke(
        Command("probe", probe), ["simple", *words], catch_exceptions=False, standalone_mode=False
    )
    return heard[0]


def test_a_new_field_is_an_option_of_the_command_line() -> None:
    assert said("--water-level", "1.5") == Flooded(water_level=1.5)
    assert said("--current", "0.5,-1", "--size", "20") == Flooded(current=(0.5, -1.0), size=20.0)
    assert said("--option", "salt=some", "--option", "waves=yes") == Flooded(salt="some", waves=True)
    assert said("--option", "water-level=2", "--option", "waves=false") == Flooded(water_level=2.0)


def test_a_command_may_have_few_flags_of_a_class() -> None:
    heard: list[Flooded] = []

    def probe(options: Annotated[Flooded, ("size", "salt")]) -> None:
        """Listen."""
        heard.append(options)

    command = Command("probe", probe)
    flags = {flag for p in command.params if isinstance(p, click.Option) for flag in p.opts}
    assert flags == {"--size", "--salt", "--option"}
    words = ["--salt", "some", "--option", "current=1,2"]
    CliRunner().invoke(command, words, catch_exceptions=False, standalone_mode=False)
    assert heard == [Flooded(salt="some", current=(1.0, 2.0))]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--water-level -1", "water level must be a finite number above 0, got -1.0"),
        ("--water-level deep", "--water-level must be a number, got 'deep'"),
        ("--current 1", "--current must be U,V, got '1'"),
        ("--current 1,2,3", "--current must be U,V, got '1,2,3'"),
        ("--option salt=much", "--option salt must be none or some, got 'much'"),
    ],
)
def test_a_new_field_is_checked(words: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        said(*words.split())
    assert str(error.value) == message


def test_a_new_field_knows_its_sources() -> None:
    deep = Flooded(water_level=2.0)
    with warnings.catch_warnings(action="error"):
        warn_without_effect(Source(SourceKind.PICTURE, Path("a.png"), "a"), deep)
    with pytest.warns(UserWarning, match=r"a\.yaml: --water-level has no effect on a laser map"):
        warn_without_effect(Source(SourceKind.MAP, Path("a.yaml"), "a"), deep)


def test_a_new_field_is_in_the_command_of_a_run() -> None:
    command = command_of(RunConfig(source="a.png", build=Flooded(water_level=2.0, current=(1.0, 2.0))))
    assert command.endswith("--option water_level=2 --option current=1,2")


def test_a_run_in_a_log_says_who_maps_it(tmp_path: Path) -> None:
    log = tmp_path / "room.clf"
    log.write_text("")
    with pytest.raises(LogSourceError, match=r"room.clf: a log is mapped .*lirs_validation.resolve_source$"):
        build_scenario(RunConfig(source=str(log)))


def test_a_list_takes_the_type_of_its_elements() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Lists(BuildOptions):
        """Options that are lists."""

        names: tuple[str, ...] = option((), "Names.")
        numbers: tuple[int, ...] = option((), "Numbers.")
        words: tuple[Literal["a", "b"], ...] = option((), "Words.")

    heard: list[Any] = []

    def probe(options: Lists) -> None:
        """Listen."""
        heard.append((options.names, options.numbers, options.words))

    probe.__annotations__["options"] = Lists
    words = ["--names", "x,y", "--numbers", "1-3,7", "--words", "b,a"]
    CliRunner().invoke(Command("probe", probe), words, catch_exceptions=False, standalone_mode=False)
    assert heard == [(("x", "y"), (1, 2, 3, 7), ("b", "a"))]
    with pytest.raises(ConfigError, match=r"^words must be a or b, got 'c'"):
        Lists(words=("a", "c"))  # type: ignore[arg-type]
