"""Readings of bags that mean no return, and limits that no sensor has."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.arrays import Float32Array
from lirs_wct.formats.range_codes import RangeDecoder

SCANS, BEAMS = 120, 181


def room(share: float = 0.3, reach: float = 8.0) -> tuple[list[Float32Array], np.ndarray]:
    """Return scans of readings up to `reach`, and where nothing came back."""
    rng = np.random.default_rng(4)
    ranges = rng.uniform(0.5, reach, (SCANS, BEAMS)).astype(np.float32)
    return list(ranges), rng.uniform(size=(SCANS, BEAMS)) < share


def decoder(
    ranges: list[Float32Array], least: float = 0.1, most: float = 8.0, given: float | None = None
) -> RangeDecoder:
    return RangeDecoder(ranges, (least, most), given)


NOISE = np.random.default_rng(5).normal(0, 0.01, (SCANS, BEAMS))
CODES = {
    "range_max": (8.0, 8.0),
    "just below": (7.99, 8.0),
    "noisy": (8.0 + NOISE, 8.0),
    "noisy below": (8.0 - 2 * np.abs(NOISE), 8.0),
    "beyond": (65.533, 80.0),
    "beyond reason": (1000.0, 8.0),
    "infinite": (math.inf, 8.0),
}


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("share", [0.1, 0.6])
def test_codes_are_found(name: str, share: float) -> None:
    code, most = CODES[name]
    ranges, missing = room(share)
    coded = list(np.where(missing, code, ranges).astype(np.float32))
    found = decoder(coded, most=most)
    decoded = np.stack([found.decode(r) for r in coded])
    assert np.isinf(decoded[missing]).mean() > 0.97
    assert np.isinf(decoded[~missing]).mean() < 0.01
    assert found.farthest == pytest.approx(8.0, abs=0.05)
    assert len(found.codes) == (name != "infinite")


@pytest.mark.parametrize(("least", "code"), [(0.0, True), (0.1, False)])
def test_zero_is_a_code_without_a_least_range(least: float, code: bool) -> None:
    ranges, missing = room()
    coded = list(np.where(missing, 0.0, ranges).astype(np.float32))
    found = decoder(coded, least=least)
    assert found.codes == (["0 m is a no-return code"] if code else [])
    assert np.isinf(found.decode(coded[0]))[missing[0]].all() == code


def test_walls_are_no_codes() -> None:
    ranges, _ = room()
    assert decoder(ranges).codes == []
    corridor = [r.copy() for r in ranges]
    for k, r in enumerate(corridor):
        r[80:95] = 7.95 - 0.05 * k  # a wall at the end that comes nearer
    assert decoder(corridor).codes == []


@pytest.mark.parametrize("stated", [math.inf, math.nan, 0.0, -1.0, 3.4e38, 1e4])
def test_an_impossible_largest_range_is_replaced(stated: float) -> None:
    ranges, _ = room()
    found = decoder(ranges, most=stated)
    assert found.farthest == pytest.approx(8.0, abs=0.05)
    assert found.codes[0].startswith("range_max is ")


def test_a_far_beam_is_left_out_and_millimeters_are_refused() -> None:
    ranges, _ = room()
    ranges[7][9] = 3000.0
    found = decoder(ranges, most=1e4)
    assert np.isnan(found.decode(ranges[7])[9])
    assert np.isfinite(found.decode(ranges[7])).sum() == BEAMS - 1
    with pytest.raises(ValueError, match=r"ranges up to 8,000 m: millimeters\?"):
        decoder([1000 * r for r in room()[0]], most=12000.0)


def test_the_user_says_the_largest_range() -> None:
    ranges, _ = room()
    found = decoder(ranges, given=5.0)
    assert (found.farthest, found.codes) == (5.0, [])
    assert (np.isinf(found.decode(ranges[0])) == (ranges[0] >= 5.0)).all()


@given(st.lists(st.floats(width=32), min_size=1, max_size=40), st.floats(), st.floats())
def test_any_readings_are_decoded(values: list[float], least: float, most: float) -> None:
    ranges = [np.array(values, np.float32)] * 3
    try:
        found = decoder(ranges, least, most)
    except ValueError:  # millimeters
        return
    decoded = found.decode(ranges[0])
    assert 0 <= found.farthest <= 300
    finite = decoded[np.isfinite(decoded)]
    assert (finite <= 300).all()


@pytest.mark.parametrize("code", [3.0, 0.1])
def test_an_exact_code_below_the_largest_reading_is_found(code: float) -> None:
    ranges, missing = room(0.2)
    coded = list(np.where(missing, code, ranges).astype(np.float32))
    found = decoder(coded)
    assert found.codes == [f"{code:g} m is a no-return code"]
    assert (np.isinf(found.decode(coded[0])) == (missing[0] | (ranges[0] == np.float32(code)))).all()


def test_a_wall_near_range_max_is_none_where_the_driver_reports_infinity() -> None:
    """A robot at rest before a wall at 7.95 of 8 m."""
    ranges, missing = room(0.2)
    still = np.tile(ranges[0], (SCANS, 1))
    still[:, 60:120] = 7.95 + NOISE[:, 60:120]
    coded = list(np.where(missing, np.inf, still).astype(np.float32))
    found = decoder(coded)
    assert found.codes == []
    assert (np.isinf(found.decode(coded[0])) == missing[0]).all()
