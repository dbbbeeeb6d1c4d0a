"""Parameters of a case, their limits, and the words for a cause."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_envs.generators.arena import SIDE, WALL_HEIGHT, ArenaConfig, arena
from lirs_extensions.search.falsify.results import sentence
from lirs_extensions.search.falsify.search import (
    OF_ARENA,
    PARAMETERS,
    SearchLimits,
    arena_options,
    read_search_limits,
    write_case,
)
from lirs_extensions.search.options import FalsifyOptions
from lirs_wct.errors import WctError

LIMITS = SearchLimits()


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_every_position_is_a_legal_case_within_the_limits(seed: int) -> None:
    case = LIMITS.case(np.random.default_rng(seed).random(len(LIMITS.free)))
    for parameter in PARAMETERS:
        value = case.values[parameter.name]
        assert parameter.low <= value <= parameter.high
        assert not parameter.whole or value == int(value)
    ArenaConfig(**arena_options(case, seed))


def test_parameters_of_the_arena_are_its_fields_with_its_defaults() -> None:
    defaults = {f.name: f.default for f in fields(ArenaConfig)}
    assert set(OF_ARENA) | {"seed"} == set(defaults)
    assert all(p.default == defaults[p.name] for p in PARAMETERS if p.name in OF_ARENA)


def test_held_parameters_are_not_searched() -> None:
    held = LIMITS.held(["lag", "slope"])
    assert {p.name for p in LIMITS.free} - {p.name for p in held.free} == {"lag", "slope"}
    case = held.case(np.ones(len(held.free)))
    assert case.values["lag"] == 0.0
    assert case.values["slope"] == 0.0


def test_limits_of_a_file_replace_the_usual_ones(tmp_path: Path) -> None:
    path = tmp_path / "within.yaml"
    path.write_text("slope: [2, 8]\nlag: 0.05\nreturns: 0.1\n")
    limits = read_search_limits(path)
    found = {p.name: p for p in limits.parameters}
    assert (found["slope"].low, found["slope"].default, found["slope"].high) == (2, 2, 8)
    assert found["lag"] not in limits.free
    assert limits.easiest.values["lag"] == 0.05
    assert limits.returns == 0.1
    assert found["relief"] == next(p for p in PARAMETERS if p.name == "relief")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("slop: [0, 1]", "did you mean slope"),
        ("slope: [8, 2]", "slope must be a number or [low, high] within [0, 40], got [8, 2]"),
        ("slope: [0, 90]", "within [0, 40]"),
        ("slope: steep", "got 'steep'"),
        ("dropout: 2", "within [0, 1]"),
        ("slope: [0, .nan]", "slope must be"),
        ("slope: true", "got True"),
        ("- 3", "must hold names and values"),
        ("", "must hold names and values"),
        ("a: [", "line"),
    ],
)
def test_a_bad_limits_file_is_one_line_with_its_path(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "within.yaml"
    path.write_text(text)
    with pytest.raises(WctError) as caught:
        read_search_limits(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_sentence_names_the_changed_parameters_alone() -> None:
    options = FalsifyOptions(mapper="hector")
    case = LIMITS.easiest.with_value("slope", 14.0).with_value("corridor", 20.0)
    text = sentence(options, case, LIMITS)
    assert text == (
        "hector on husky fails with 14 deg cross slope and two parallel walls 20 m long and 3 m apart."
    )
    against = FalsifyOptions(mapper="gmapping", reference="hector")
    assert sentence(against, LIMITS.easiest, LIMITS).endswith("already; hector does not.")


def test_a_case_folder_holds_the_run(tmp_path: Path) -> None:
    options = FalsifyOptions(mapper="hector", seconds=5.0)
    case = LIMITS.easiest.with_value("lag", 0.06).with_value("actors", 2.0).with_value("speed", 0.5)
    config = write_case(tmp_path / "case-1", case, options, method="gmapping", seed=7, comment="a line")
    assert (config.mapper, config.seed, config.actors, config.speed) == ("gmapping", 7, 2, 0.5)
    assert config.noise == str(tmp_path / "case-1" / "noise.yaml")
    assert (tmp_path / "case-1" / "case.yaml").read_text().startswith("# a line\n")


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 26), st.floats(2.4, 6.0), st.integers(0, 60), st.integers(0, 99))
def test_the_start_is_clear_and_the_corridor_as_wide_as_asked(
    corridor: float, width: float, obstacles: int, seed: int
) -> None:
    config = ArenaConfig(corridor=corridor, corridor_width=width, obstacles=obstacles, seed=seed)
    world = arena("a", config)
    z = world.surface.z
    middle = z.shape[0] // 2
    assert world.surface.size == (pytest.approx(SIDE), pytest.approx(SIDE))
    assert z[middle - 8 : middle + 9, middle - 8 : middle + 9].max() == 0.0
    if corridor > 1:
        across = np.flatnonzero(z[:, middle] == WALL_HEIGHT)
        nearest = np.abs(across - middle).min() * world.surface.cell[1]
        assert nearest == pytest.approx(width / 2, abs=0.11)


def test_the_documented_limits_are_those_in_use() -> None:
    page = (Path(__file__).resolve().parents[4] / "docs" / "howto" / "falsify.md").read_text(encoding="utf-8")
    for p in PARAMETERS:
        unit = f" {p.unit}" if p.unit else ""
        assert f"| `{p.name}` | {p.default:g}{unit} | {p.low:g} to {p.high:g} |" in page
