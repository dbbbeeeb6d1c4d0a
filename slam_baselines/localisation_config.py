"""Parameters of localisation in a known map."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_wct.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class LocalisationConfig:
    """When a place is believed.

    Attributes:
        min_score: mean occupancy at the ends of the beams that a place found in the whole map needs.
        rival: it is not believed if another place has this share of its score ...
        apart: ... at least so far from it, metres.
        every: while the place is unknown it is searched for after so much way, metres ...
        seconds: ... or so much time.
        beams: at most so many beams are used to search, evenly spread in space ...
        least_beams: ... and fewer than this say nothing.
        bounded: a search is given up after so many nodes of its tree.
        lost_score: mean occupancy at the ends of the beams below which a scan does not fit ...
        lost_after: ... and after so many of them in a row the place is unknown.
        start: standard deviation of a pose that is given, metres and radians.

    Raises:
        ConfigError: a value that is not above 0, or a share above 1.
    """

    min_score: float = 0.55
    rival: float = 0.9
    apart: float = 1.0
    every: float = 1.0
    seconds: float = 5.0
    beams: int = 150
    least_beams: int = 30
    bounded: int = 1 << 20
    lost_score: float = 0.2
    lost_after: int = 10
    start: tuple[float, float] = (0.3, 0.1)

    def __post_init__(self) -> None:
        for name in set(self.__dataclass_fields__) - {"start"}:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the localisation must be above 0, got {getattr(self, name)}")
        if max(self.min_score, self.rival, self.lost_score) > 1:
            raise ConfigError("min_score, rival and lost_score of the localisation must be at most 1")
