"""Whether scans still fit into the map: when to stop believing the pose."""

from __future__ import annotations


class FitCounter:
    """Counts scans in a row that do not fit into what is known.

    Before the first good fit nothing is known that a scan could contradict.
    """

    def __init__(self, lost_score: float, known_ratio: float, lost_after: int) -> None:
        """Set the limits.

        Args:
            lost_score: share of the beams on known cells that must end at a wall ...
            known_ratio: ... where at least so many of all beams end on known cells.
            lost_after: the mapper is lost after so many scans in a row that do not fit.
        """
        self._limits = lost_score, known_ratio
        self._lost_after = lost_after
        self._poor_in_a_row = 0
        self._settled = False

    def note(self, hit_ratio: float, known: float) -> None:
        """Take note of a scan: share of beams that met walls, of those on known cells; share of these."""
        score, share = self._limits
        tells = known > share
        poor = tells and hit_ratio < score
        self._settled |= tells and not poor
        self._poor_in_a_row = self._poor_in_a_row + 1 if poor and self._settled else 0

    @property
    def good(self) -> bool:
        """Whether the last scan fitted, or nothing could be said about it."""
        return self._poor_in_a_row == 0

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row did not fit."""
        return self._poor_in_a_row >= self._lost_after
