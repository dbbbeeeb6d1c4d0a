"""Lists in arguments: names and seeds, one reader each for every command."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lirs_validation.config import read_drivers
from lirs_wct.errors import ConfigError
from lirs_wct.option import read_names, read_numbers


def test_names_are_read_each_once() -> None:
    assert read_names("husky, jackal,husky", "--robot") == ("husky", "jackal")


@pytest.mark.parametrize("text", ["", ",", "a,,b", "a,"])
def test_a_list_with_a_missing_name_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--robot must be a list such as a,b,c"):
        read_names(text, "--robot")


@pytest.mark.parametrize(
    ("text", "drivers"),
    [
        ("tour", ("tour",)),
        ("tour, frontier,tour", ("tour", "frontier")),
        ("goal:1,-2.5,tour", ("goal:1,-2.5", "tour")),
        ("waypoints:a,b.csv,frontier", ("waypoints:a,b.csv", "frontier")),
        (
            "replay:out/x,waypoints:a/tour,b.csv,replay:y",
            ("replay:out/x", "waypoints:a/tour,b.csv", "replay:y"),
        ),
    ],
)
def test_drivers_are_read_though_paths_hold_commas(text: str, drivers: tuple[str, ...]) -> None:
    assert read_drivers(text) == drivers


@pytest.mark.parametrize("text", ["", "tours", "tour,", "frontier:x", "waypoints", "replay:", "tour,walk"])
def test_what_is_no_driver_is_told_with_the_legal_ones(text: str) -> None:
    with pytest.raises(
        ConfigError, match=r"--driver: unknown driver .*legal: tour, frontier, waypoints:FILE"
    ):
        read_drivers(text)


@settings(max_examples=25)
@given(st.lists(st.tuples(st.integers(0, 999), st.integers(0, 20)), min_size=1, max_size=6))
def test_seeds_are_read_as_written(ranges: list[tuple[int, int]]) -> None:
    text = ",".join(f"{a}-{a + n}" if n else f"{a}" for a, n in ranges)
    expected = [seed for a, n in ranges for seed in range(a, a + n + 1)]
    assert read_numbers(text, "--seeds") == tuple(dict.fromkeys(expected))


@pytest.mark.parametrize("text", ["", "a", "1-", "-3", "5-1", "1,,2", "1.5", "0-99999999999", "1-999999999"])
def test_what_is_no_list_of_seeds_is_told(text: str) -> None:
    with pytest.raises(ConfigError, match="--seeds must be a list such as"):
        read_numbers(text, "--seeds")
