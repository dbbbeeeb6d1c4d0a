"""Which pairs of a node and a submap are tried next: many could be, a few at a time are.

New nodes come first, the newest of them at once; pairs of old nodes and a submap that has just been
finished follow when there is time. Two stretches of the way need only so many ties between them.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

from lirs_wct.errors import ConfigError

Pair = tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class QueueConfig:
    """How many pairs are tried.

    Attributes:
        sampling_ratio: share of the nodes that are searched for in the submaps around them.
        max_constraint_distance: nodes farther than this from a submap's nodes are not searched for, metres.
        found_per_pair: between the nodes of a submap and another submap, so many loops are enough ...
        tries_per_pair: ... and after so many searches without that, no more are tried.
        max_num_candidates: pairs that may wait; beyond that the oldest are dropped, and counted.

    Raises:
        ConfigError: a value that is not above 0, or a ratio above 1.
    """

    sampling_ratio: float = 0.2
    max_constraint_distance: float = 12.0
    found_per_pair: int = 8
    tries_per_pair: int = 8
    max_num_candidates: int = 2000

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the loop queue must be above 0, got {getattr(self, name)}")
        if self.sampling_ratio > 1:
            raise ConfigError(f"sampling_ratio must be within (0, 1], got {self.sampling_ratio}")


class LoopQueue:
    """The pairs that wait.

    Attributes:
        dropped: pairs that were never tried because too many waited.
    """

    def __init__(self, config: QueueConfig) -> None:
        self.config = config
        self.dropped = 0
        self._fresh: deque[Pair] = deque()
        self._backlog: deque[Pair] = deque()
        self._tried: Counter[Pair] = Counter()
        self._found: Counter[Pair] = Counter()
        self._stretch: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._fresh) + len(self._backlog)

    def ask(self, node: int, stretch: int, submap: int, *, fresh: bool) -> None:
        """Put a pair into the queue.

        Args:
            node: index.
            stretch: index of the submap that the node belongs to.
            submap: index.
            fresh: whether it is the node that is new, and not the submap.
        """
        self._stretch[node] = stretch
        queue = self._fresh if fresh else self._backlog
        queue.append((node, submap))
        if len(queue) > self.config.max_num_candidates:
            queue.popleft()
            self.dropped += 1

    def next(self) -> Pair | None:
        """Take the next pair out of the queue; None where no pair is worth a search."""
        c = self.config
        while self._fresh or self._backlog:
            node, submap = self._fresh.pop() if self._fresh else self._backlog.popleft()
            between = self._stretch[node], submap
            if self._found[between] < c.found_per_pair and self._tried[between] < c.tries_per_pair:
                return node, submap
        return None

    def note(self, node: int, submap: int, *, found: bool) -> None:
        """Note what a search came to."""
        between = self._stretch[node], submap
        self._tried[between] += 1
        self._found[between] += found
