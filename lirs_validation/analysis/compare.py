"""Two results side by side: which differences are real, and which may be chance.

Runs are paired by cell and seed: both of a pair had the same world, tour and noise, so that only what was
changed can differ. Per cell and figure the mean of the paired differences gets its 95 % confidence interval
and a two-sided p value; all p values of a comparison are corrected together after Holm, "A Simple
Sequentially Rejective Multiple Test Procedure" (Scandinavian Journal of Statistics, 1979).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from lirs_validation.analysis.groups import FIELDS, Cell, Entry, by_cell
from lirs_validation.analysis.paired import Test, holm, paired_test
from lirs_validation.record.catalog import Figure, rtf_counts
from lirs_validation.record.run_record import SOUND
from lirs_wct.errors import ConfigError, unknown_name

LEVEL = 0.05
"""A difference is real where its corrected p value is below this."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """How a figure of a cell differs between two results, b minus a, over the seeds that both have.

    Attributes:
        cell: which.
        figure: which, in its own unit.
        a: mean in the first result.
        b: mean in the second.
        difference: mean of the paired differences.
        low: lower end of its 95 % interval; None of one pair.
        high: upper end.
        pairs: how many seeds both results have.
        test: paired t; Wilcoxon's signed ranks where the differences are plainly not normal (the interval is
            then bootstrapped); the sign test where all are the same; none of one pair.
        p: two-sided, as tested; None of one pair.
        p_corrected: after Holm, over all tests of the comparison.
    """

    cell: Cell
    figure: Figure
    a: float
    b: float
    difference: float
    low: float | None
    high: float | None
    pairs: int
    test: Test
    p: float | None
    p_corrected: float | None = None

    @property
    def real(self) -> bool | None:
        """Whether it is more than chance; None where one pair cannot say."""
        return None if self.p_corrected is None else self.p_corrected < LEVEL


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All differences of two results.

    Attributes:
        differences: by cell and figure.
        only_a: cells that only the first result has.
        only_b: cells that only the second has.
        failed_a: sound and failed runs of each common cell in the first result.
        failed_b: the same in the second.
    """

    differences: tuple[Difference, ...]
    only_a: tuple[Cell, ...]
    only_b: tuple[Cell, ...]
    failed_a: dict[Cell, tuple[int, int]]
    failed_b: dict[Cell, tuple[int, int]]


def compare(
    a: Sequence[Entry], b: Sequence[Entry], figures: Sequence[Figure], across: Sequence[str] = ()
) -> Comparison:
    """Compare the sound runs of two results by cell and seed.

    Args:
        a: records of the first result.
        b: records of the second.
        figures: what to compare.
        across: fields of a cell in which the two may differ, such as `mapper`.

    Raises:
        ConfigError: a field has no such name, no cell is in both, or one holds a seed twice.
    """
    for field in across:
        if field not in FIELDS:
            raise unknown_name("field of a cell", field, FIELDS)
    runs_a, runs_b = by_shared(a, across), by_shared(b, across)
    common = [cell for cell in runs_a if cell in runs_b]
    if not common:
        raise ConfigError(_nothing_common(list(by_cell(a)), list(by_cell(b))))
    found = [
        difference
        for cell in common
        for figure in figures
        if (difference := _difference(cell, figure, runs_a[cell], runs_b[cell])) is not None
    ]
    return Comparison(
        differences=corrected(found),
        only_a=tuple(cell for cell in runs_a if cell not in runs_b),
        only_b=tuple(cell for cell in runs_b if cell not in runs_a),
        failed_a={cell: _counts(runs_a[cell]) for cell in common},
        failed_b={cell: _counts(runs_b[cell]) for cell in common},
    )


def by_shared(entries: Sequence[Entry], across: Sequence[str]) -> dict[Cell, dict[int, Entry]]:
    """Return the runs of each cell by seed, the fields in `across` left open.

    Raises:
        ConfigError: a cell holds a seed twice.
    """
    found: dict[Cell, dict[int, Entry]] = {}
    for entry in entries:
        runs = found.setdefault(_shared(Cell.of(entry), across), {})
        seed = int(entry["seed"])
        if seed in runs:
            raise ConfigError(
                f"two runs of one cell and seed, {runs[seed]['name']} and {entry['name']}: which is meant?"
            )
        runs[seed] = entry
    return found


def corrected(differences: Sequence[Difference]) -> tuple[Difference, ...]:
    """Return the differences with their p values corrected after Holm."""
    tested = [k for k, d in enumerate(differences) if d.p is not None]
    raw = np.array([differences[k].p for k in tested], dtype=np.float64)
    result = list(differences)
    for k, p in zip(tested, holm(raw).tolist(), strict=True):
        result[k] = replace(differences[k], p_corrected=p)
    return tuple(result)


def _difference(cell: Cell, figure: Figure, a: dict[int, Entry], b: dict[int, Entry]) -> Difference | None:
    """Compare one figure over the seeds in which both runs are sound; None where none has it."""
    values = [
        (x, y)
        for seed in sorted(set(a) & set(b))
        if _usable(figure, a[seed], b[seed])
        and (x := figure.of(a[seed])) is not None
        and (y := figure.of(b[seed])) is not None
    ]
    if not values:
        return None
    x, y = np.array(values).T
    test, p, low, high = paired_test(y - x)
    return Difference(
        cell=cell,
        figure=figure,
        a=float(x.mean()),
        b=float(y.mean()),
        difference=float((y - x).mean()),
        low=low,
        high=high,
        pairs=len(values),
        test=test,
        p=p,
    )


def _usable(figure: Figure, *runs: Entry) -> bool:
    sound = all(run["status"] in SOUND for run in runs)
    return sound and (not figure.place.startswith("rtf.") or all(map(rtf_counts, runs)))


def _shared(cell: Cell, across: Sequence[str]) -> Cell:
    """Return the cell with the fields in `across` left open."""
    blank = {f.name: 0.0 if f.name == "seconds" else "*" for f in fields(Cell) if f.name in across}
    return replace(cell, **blank)  # type: ignore[arg-type]


def _counts(runs: dict[int, Entry]) -> tuple[int, int]:
    sound = sum(run["status"] in SOUND for run in runs.values())
    return sound, len(runs) - sound


def _nothing_common(a: Sequence[Cell], b: Sequence[Cell]) -> str:
    """Say in which fields the two results have nothing in common."""
    apart = [f for f in FIELDS if not {getattr(cell, f) for cell in a} & {getattr(cell, f) for cell in b}]
    told = ", ".join(
        f"{f} ({'/'.join(sorted({str(getattr(c, f)) for c in a}))} and "
        f"{'/'.join(sorted({str(getattr(c, f)) for c in b}))})"
        for f in apart
    )
    if not apart:
        return "the results have no cell in common (world, robot, mapper, terrain, rays, LRF, seconds)"
    return f"the results have no cell in common: they differ in {told}; --across {','.join(apart)} pairs them"
