"""Tracking monitor: fit of scans to the map, and loss of tracking."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_wct.checks import Checked, limited


@dataclass(frozen=True, kw_only=True)
class TrackingConfig(Checked, of="the tracking"):
    """Thresholds of a contradiction between scan and map, and of a lost mapper.

    Attributes:
        lost_score: score below which a scan contradicts the map.
        known_ratio: share of beams on known cells below which a score does not count.
        lost_after: contradicting scans in a row after which the mapper is lost.
    """

    lost_score: float = limited(0.25, "(0, 1]")
    known_ratio: float = limited(0.3, "(0, 1]")
    lost_after: int = limited(10, "[1, inf]")


class TrackingMonitor:
    """Count of the scans in a row that contradict the map.

    Before the first scan that fits, no scan can contradict a map under construction.
    """

    def __init__(self, config: TrackingConfig, *, map_given: bool = False) -> None:
        """Start; with `map_given`, the first scan can already contradict the map."""
        self._config = config
        self._contradictable = map_given
        self._in_a_row = 0

    def observe(self, score: float | None, known: float = 1.0) -> bool:
        """Count a scan; return whether it fits, so that it may enter the map.

        Args:
            score: agreement of the ends of its beams on known cells with the map, 0 to 1; None where the scan
                cannot be judged, which counts as fitting.
            known: share of its beams that end on known cells.
        """
        informative = score is not None and known >= self._config.known_ratio
        contradicts = score is not None and informative and score < self._config.lost_score
        self._contradictable |= informative and not contradicts
        self._in_a_row = self._in_a_row + 1 if contradicts and self._contradictable else 0
        return self.fits

    @property
    def fits(self) -> bool:
        """Whether the last scan fitted or could not be judged."""
        return self._in_a_row == 0

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row contradict the map."""
        return self._in_a_row >= self._config.lost_after
