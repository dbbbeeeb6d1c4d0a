"""Monitors of the matches: whether they localize the robot, and whether scans contradict the map."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_wct.errors import Checked, limited, require_within


@dataclass(frozen=True, kw_only=True)
class MonitorConfig(Checked):
    """Conditions under which matches are used, walls are drawn, and a mapper is lost.

    Attributes:
        lost_score: Score below which a scan contradicts the map.
        known_ratio: Share of beams on known cells below which a score does not count.
        lost_after: Contradicting scans in a row after which the mapper is lost.
        localizable_score: Mean occupancy at the ends of the beams from which on a scan fits: on walls 9 of 10
            scans do, on hillsides few.
        localizable_share: Share of the matched scans that must fit before matches are used.
        least_localizable_share: Share of the matched scans that must fit for matches to remain in use.
        sure_share: Share of the latest scans that must fit for any match that fits to be used.
        localizable_memory: Number of scans that prove walls.
        localizable_meters: Distance after which a scan counts 1/e, meters.
        first_meters: Distance that counts as driven without a fit at first, unless on a floor, meters.
        drawn_share: Share of all scans that must have fitted for walls to be drawn.
        recent_share: Share of the latest scans that must have fitted for half of `drawn_share` to be enough.
        drawn_meters: Distance up to which walls are drawn in any case, since dead reckoning is good enough,
            meters; unless `localizable_memory` scans were matched and fewer than `drawn_share` fitted lately.
        reckoning_length: Distance over which a correction of dead reckoning falls to 1/e, meters.
        reckoning_gate: Deviations of dead reckoning up to which its corrections are used on uneven ground.

    Raises:
        ConfigError: a value is not legal, or least_localizable_share is above localizable_share.
    """

    lost_score: float = limited(0.25, "(0, 1]")
    known_ratio: float = limited(0.3, "(0, 1]")
    lost_after: int = limited(10, "[1, inf]")
    localizable_score: float = limited(0.6, "(0, 1)")
    localizable_share: float = limited(0.7, "(0, 1)")
    least_localizable_share: float = 0.15
    sure_share: float = limited(0.95, "(0, 1]")
    localizable_memory: float = limited(50.0, "[1, inf]")
    localizable_meters: float = limited(4.0, "(0, inf]")
    first_meters: float = limited(0.4, "(0, inf]")
    drawn_share: float = limited(0.5, "(0, 1)")
    recent_share: float = limited(0.8, "(0, 1)")
    drawn_meters: float = limited(5.0, "(0, inf]")
    reckoning_length: float = limited(10.0, "(0, inf]", "m")
    reckoning_gate: float = limited(3.0, "(0, inf]")

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"(0, {self.localizable_share}]", "least_localizable_share")


class TrackingMonitor:
    """Count of the scans in a row that contradict the map.

    Before the first scan that fits, no scan can contradict a map under construction.

    Attributes:
        fits: Whether the last scan fitted or could not be judged.
        lost: Whether too many scans in a row contradict the map.
    """

    def __init__(self, config: MonitorConfig, *, map_given: bool = False) -> None:
        """Start; with `map_given`, the first scan can already contradict the map."""
        self.fits, self.lost = True, False
        self._config = config
        self._contradictable = map_given
        self._in_a_row = 0

    def observe(self, score: float | None, known: float = 1.0) -> bool:
        """Count a scan; return whether it fits, so that it may enter the map.

        Args:
            score: Agreement of its beams on known cells with the map, 0 to 1; None, and fitting, where it
                cannot be judged.
            known: Share of its beams that end on known cells.
        """
        informative = score is not None and known >= self._config.known_ratio
        contradicts = score is not None and informative and score < self._config.lost_score
        self._contradictable |= informative and not contradicts
        self._in_a_row = self._in_a_row + 1 if contradicts and self._contradictable else 0
        self.fits, self.lost = self._in_a_row == 0, self._in_a_row >= self._config.lost_after
        return self.fits


class LocalizabilityMonitor:
    """Decision whether matches localize the robot: they do on walls, and not on hillsides.

    A planar scan of a hillside fits the map of the same hillside from the same place only: from another
    height, the hillside seems to have moved. So on walls most scans fit well while the robot moves.

    Attributes:
        localizable: Whether matches localize the robot.
        believed: Whether matches are used; always if no scan was observed, for lack of an attitude.
        steady: Whether enough scans fit for calibrating the odometry by them.
        trusted_score: Score from which a match is used though it disagrees with those before.
        proven: Whether walls localized the robot long enough; then contradictions mean that it is lost.
        scans: Number of observed scans.
    """

    def __init__(self, config: MonitorConfig) -> None:
        self.localizable = self.steady = self.proven = False
        self.believed, self.trusted_score = True, 0.0
        self.scans = self._matched = self._localizable = self._fitted = 0
        self._config = config
        self._share = self._steadiness = self._fitting = self._judged = 0.0

    def observe(self, score: float | None, moved: float, *, floor: bool = False) -> None:
        """Count a scan by its distance: a hillside fits from the same place only.

        Args:
            score: Agreement of the ends of its beams with the map, 0 to 1; None without a match.
            moved: Distance since the scan before, a radian of turn counted as half a meter, meters.
            floor: Whether the ground has always been a floor, where there are no hillsides.
        """
        c = self._config
        fits = score is not None and score >= c.localizable_score
        keep = math.exp(-moved / c.localizable_meters)
        self._steadiness = keep * self._steadiness + (1 - keep) * fits
        if score is not None:
            self._matched += 1
            self._fitting, self._judged = keep * self._fitting + moved * fits, keep * self._judged + moved
        self._share = self._fitting / (self._judged + (1e-9 if floor else c.first_meters))
        enough = c.least_localizable_share if self.localizable else c.localizable_share
        recent = self._steadiness >= c.least_localizable_share
        self.localizable = self._share >= enough and recent
        self.steady = self.localizable and self._steadiness >= 2 * c.least_localizable_share
        self.trusted_score = c.localizable_score if self._steadiness >= c.sure_share else math.inf
        self.believed = self.localizable
        self.scans += 1
        self._localizable += self.localizable
        self._fitted += self.localizable and fits
        self.proven = self._localizable >= c.localizable_memory

    def draws(self, distance: float) -> bool:
        """Return whether walls may be drawn after a distance driven, meters.

        If walls seldom localize the robot, dead reckoning placed them, and assumed walls may be ground. The
        first scans of a slow robot do not count, since the map is still too faint.
        """
        c = self._config
        doubtful = self._matched >= c.localizable_memory and self._share < c.drawn_share
        if self.scans == 0 or (distance <= c.drawn_meters and not doubtful):
            return True
        recently = self.proven and self._steadiness >= c.recent_share
        return self._fitted >= (0.5 if recently else 1.0) * c.drawn_share * self.scans


class Monitors:
    """Both monitors of a mapper."""

    def __init__(self, config: MonitorConfig) -> None:
        self.tracking = TrackingMonitor(config)
        self.localizability = LocalizabilityMonitor(config)

    def observe_fit(self, score: float | None, known: float) -> bool:
        """Return whether a scan may enter the map; before walls are proven, any may."""
        unproven = self.localizability.scans and not self.localizability.proven
        return self.tracking.observe(None if unproven else score, known)
