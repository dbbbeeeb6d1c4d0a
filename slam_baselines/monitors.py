"""Tracking monitor: fit of scans to the map, and loss of tracking."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_wct.checks import Checked, limited, require_within
from lirs_wct.geometry import wrap_angle


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


@dataclass(frozen=True, kw_only=True)
class LocalizabilityConfig(Checked, of="localizability"):
    """Conditions under which matches localize the robot.

    Attributes:
        score: mean occupancy at the ends of the beams from which on a scan fits: on walls 9 of 10 scans
            do, on hillsides few.
        share: share of the matched scans that must fit before matches are used.
        least_share: share of the matched scans that must fit for matches to remain in use.
        memory: scans after which one counts 1/e.
        turn: largest turn of matches away from dead reckoning within `seconds`, radians.
        seconds: time in which this turn is measured.
        drawn_share: share of all scans that must have fitted for walls to be drawn.
        recent_share: share of the latest scans that must have fitted for half of `drawn_share` to be enough.
        first_meters: distance up to which walls are drawn in any case, since dead reckoning is good enough
            there, meters; unless `memory` scans were matched and fewer than `drawn_share` of the latest
            fitted.

    Raises:
        ConfigError: a value is not legal, or least_share is above share.
    """

    score: float = limited(0.6, "(0, 1)")
    share: float = limited(0.7, "(0, 1)")
    least_share: float = 0.15
    memory: float = limited(50.0, "[1, inf]")
    turn: float = limited(math.radians(1.5), "(0, inf]")
    seconds: float = limited(5.0, "(0, inf]")
    drawn_share: float = limited(0.5, "(0, 1)")
    recent_share: float = limited(0.8, "(0, 1)")
    first_meters: float = limited(5.0, "(0, inf]")

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"(0, {self.share}]", "least_share", of="localizability")


class LocalizabilityMonitor:
    """Decision whether matches localize the robot.

    Attributes:
        localizable: whether they do.
        steady: whether enough scans fit for calibrating the odometry by them.
        scans: number of observed scans.
    """

    def __init__(self, config: LocalizabilityConfig) -> None:
        self.localizable = self.steady = False
        self.scans = self._matched = self._localizable = self._fitted = 0
        self._config = config
        self._share = self._turned = self._steadiness = 0.0
        self._off: float | None = None

    def observe(self, score: float | None, off: float, seconds: float) -> None:
        """Count a scan.

        Args:
            score: agreement of the ends of its beams with the map, 0 to 1; None without a match.
            off: yaw of the match less the yaw by dead reckoning since the start, radians.
            seconds: since the scan before.
        """
        c = self._config
        fits = score is not None and score >= c.score
        self._turned *= math.exp(-seconds / c.seconds)
        self._steadiness += (fits - self._steadiness) / c.memory
        if score is not None:
            self._matched += 1
            self._share += (fits - self._share) / min(self._matched, c.memory)
            self._turned += 0.0 if self._off is None else wrap_angle(off - self._off)
            self._off = off
        enough = self._share >= (c.least_share if self.localizable else c.share)
        self.localizable = enough and abs(self._turned) <= c.turn
        self.steady = self.localizable and self._steadiness >= 2 * c.least_share
        self.scans += 1
        self._localizable += self.localizable
        self._fitted += self.localizable and fits

    @property
    def believed(self) -> bool:
        """Whether matches are used; always if no scan was observed, for lack of an attitude."""
        return self.localizable or self.scans == 0

    @property
    def proven(self) -> bool:
        """Whether walls localized the robot long enough; then contradictions mean that it is lost."""
        return self._localizable >= self._config.memory

    @property
    def _doubtful(self) -> bool:
        """Whether enough scans were matched, and too few of them fit.

        The first scans of a slow robot do not count, since the map is still too faint.
        """
        c = self._config
        fit = self._share >= c.drawn_share and abs(self._turned) <= c.turn
        return self._matched >= c.memory and not fit

    def draws(self, distance: float) -> bool:
        """Return whether walls may be drawn after a distance driven, meters.

        If walls seldom localize the robot, dead reckoning placed them, and assumed walls may be ground.
        """
        c = self._config
        if self.scans == 0 or (distance <= c.first_meters and not self._doubtful):
            return True
        recently = self.proven and self._steadiness >= c.recent_share
        return self._fitted >= (0.5 if recently else 1.0) * c.drawn_share * self.scans
