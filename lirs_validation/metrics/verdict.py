"""Rules for failed results: lost, incomplete or inconsistent, worse than the odometry.

The same rules hold for runs, mapped logs and scores; only mapped logs are tested for scans that contradict
each other (`lirs_validation.metrics.consistency`): a run knows the truth, and its hillsides contradict.
"""

from __future__ import annotations

LEAST_COVERAGE = 0.95
"""Share of the scans that need a pose: a few poses alone can be aligned with any truth."""
LOST_SECONDS = 5.0
LOST_SCANS = 10
"""A mapper that does not know its place for so long, and during so many scans in a row, has lost it ..."""
LOST_SHARE = 0.05
"""... and so has one that does not know it for more than this share of the scans, or whose trajectory puts
more than this share of them where they contradict other passes."""
VISIBLE = 0.0005
"""Meters that an ATE must exceed the odometry's to be visibly worse."""


class LostRule:
    """Rule that decides scan by scan whether a mapper is lost."""

    def __init__(self) -> None:
        self._scans = self._lost = 0
        self._begun = 0.0
        self._in_a_row = 0
        self._too_long: tuple[float, float] | None = None

    def observe(self, stamp: float, lost: bool) -> None:
        """Take in whether the mapper knew its place after a scan.

        Args:
            stamp: of the scan, seconds.
            lost: as the mapper reports.
        """
        self._scans += 1
        if not lost:
            self._in_a_row = 0
            return
        self._lost += 1
        self._begun = self._begun if self._in_a_row else stamp
        self._in_a_row += 1
        seconds = stamp - self._begun
        longest = 0.0 if self._too_long is None else self._too_long[0]
        if self._in_a_row >= LOST_SCANS and seconds >= max(LOST_SECONDS, longest):
            self._too_long = seconds, self._begun

    def may_end(self, first: float, last: float, scans: int) -> bool:
        """Return whether losing all next scans would mean that the mapper is lost.

        Args:
            first: stamp of the first of them, seconds.
            last: of the last.
            scans: their number.
        """
        begun = self._begun if self._in_a_row else first
        return self._in_a_row + scans >= LOST_SCANS and last - begun >= LOST_SECONDS

    @property
    def too_long(self) -> str | None:
        """Message about the longest loss, with start and duration.

        None below 5 s or 10 scans.
        """
        if self._too_long is None:
            return None
        seconds, begun = self._too_long
        return f"the mapper lost its place at {begun:.1f} s for {seconds:.1f} s"

    def reason(self) -> str | None:
        """Return why the mapper is lost; None if it is not.

        The time and the share of all scans so far count.
        """
        share = self._lost / self._scans if self._scans else 0.0
        if self.too_long is None and share <= LOST_SHARE:
            return None
        counted = f"{self._lost} of {self._scans} scans ({100 * share:.1f} %)"
        if self.too_long is None:
            return f"the mapper did not know its place during {counted}"
        return f"{self.too_long}; it did not know it during {counted}"


def incompleteness(coverage: float) -> str | None:
    """Return why a trajectory's scan coverage is too low; None if it suffices."""
    if coverage >= LEAST_COVERAGE:
        return None
    return (
        f"the trajectory has a pose for {100 * coverage:.1f} % of the scans, "
        f"at least {100 * LEAST_COVERAGE:g} % are required"
    )


def inconsistency(contradicted: float | None) -> str | None:
    """Return why the share of contradicting scans is too high; None if acceptable."""
    if contradicted is None or contradicted <= LOST_SHARE:
        return None
    return (
        f"{100 * contradicted:.1f} % of the scans end in space that other passes saw free, "
        f"at most {100 * LOST_SHARE:g} % may"
    )


def is_worse(ate: float | None, odometry: float | None) -> bool:
    """Return whether an ATE is visibly larger than the odometry's; False if one is None."""
    return ate is not None and odometry is not None and ate > odometry + VISIBLE
