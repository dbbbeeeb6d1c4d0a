"""Rule of lost mappers: the mapper itself says that it is lost, for too long or too often."""

from __future__ import annotations

LOST_SECONDS = 5.0
LOST_SCANS = 10
"""A mapper that does not know its place for so long, and during so many scans in a row, has lost it ..."""
LOST_SHARE = 0.05
"""... and so has one that does not know it for more than this share of the scans."""


class LostRule:
    """Rule that decides scan by scan whether a mapper is lost."""

    def __init__(self) -> None:
        self._scans = self._lost = self._in_a_row = 0
        self._begun = self._longest = self._longest_begun = 0.0

    def observe(self, stamp: float, lost: bool) -> None:
        """Take in whether the mapper knew its place after the scan of a stamp, seconds."""
        self._scans += 1
        if not lost:
            self._in_a_row = 0
            return
        self._lost += 1
        self._begun = self._begun if self._in_a_row else stamp
        self._in_a_row += 1
        seconds = stamp - self._begun
        if self._in_a_row >= LOST_SCANS and seconds >= max(LOST_SECONDS, self._longest):
            self._longest, self._longest_begun = seconds, self._begun

    @property
    def too_long(self) -> str | None:
        """Message about the longest loss; None below 5 s or 10 scans."""
        if self._longest == 0.0:
            return None
        return f"the mapper lost its place at {self._longest_begun:.1f} s for {self._longest:.1f} s"

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
