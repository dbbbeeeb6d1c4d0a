from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lirs_wct.errors import OutputError
from lirs_wct.spool import IN_MEMORY, ArraySpool


def filled(count: int, size: int, folder: Path | None = None) -> tuple[ArraySpool[np.float32], np.ndarray]:
    values = np.random.default_rng(count).normal(size=(count, size)).astype(np.float32)
    values[::3, ::2] = np.inf
    values[1::3, 1::2] = np.nan
    spool = ArraySpool[np.float32](folder)
    for row in values:
        spool.append(row)
    return spool, values


@pytest.mark.parametrize("count", [1, 7, IN_MEMORY // 4000 + 50])
def test_what_goes_in_comes_out_in_memory_and_on_disk(count: int, tmp_path: Path) -> None:
    spool, values = filled(count, 1000, tmp_path)
    assert len(spool) == count
    np.testing.assert_array_equal(np.array(list(spool)), values)
    np.testing.assert_array_equal(spool[-1], values[-1])
    np.testing.assert_array_equal(np.array(spool[count // 2 :]), values[count // 2 :])
    assert list(tmp_path.iterdir()) == []  # the file has no name


def test_reading_between_does_not_disturb_writing() -> None:
    spool, values = filled(IN_MEMORY // 4000 + 5, 1000)
    for k in (0, len(values) // 2):
        spool[k]
        spool.append(values[k])
    going = iter(spool)
    next(going)
    spool.append(values[1])
    np.testing.assert_array_equal(spool[len(values)], values[0])
    np.testing.assert_array_equal(spool[-1], values[1])
    np.testing.assert_array_equal(next(going), values[1])


def test_what_comes_out_is_a_copy() -> None:
    spool, values = filled(3, 4)
    spool[1][:] = 0
    next(iter(spool))[:] = 0
    np.testing.assert_array_equal(np.array(list(spool)), values)


def test_indices_are_those_of_a_sequence() -> None:
    spool, _ = filled(3, 4)
    for wrong in (3, -4):
        with pytest.raises(IndexError):
            spool[wrong]
    assert list(ArraySpool[np.float32]()) == []


def test_another_shape_or_type_is_refused() -> None:
    spool, _ = filled(1, 4)
    for wrong in (np.zeros(5, np.float32), np.zeros(4, np.float64)):
        with pytest.raises(ValueError, match=r"must be float32 \(4,\), got"):
            spool.append(wrong)  # type: ignore[arg-type]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"gone: cannot be written: No such file"):
        filled(IN_MEMORY // 4000 + 5, 1000, tmp_path / "gone")
