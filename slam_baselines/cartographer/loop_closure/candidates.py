"""Candidate pairs of a node and a submap for the loop search: many are possible, a few at a time are tried.

New nodes come first, the newest of them at once; pairs of old nodes and a submap that has just been
finished follow when there is time. Two submaps need only so many constraints between them.
"""

from __future__ import annotations

from collections import Counter, deque

from slam_baselines.cartographer.loop_closure_config import CandidateConfig

Candidate = tuple[int, int]
"""Index of a node, index of a submap."""


class CandidateQueue:
    """Candidates that wait for their search.

    Attributes:
        dropped: candidates that were never tried because too many waited.
    """

    def __init__(self, config: CandidateConfig) -> None:
        self.config = config
        self.dropped = 0
        self._new_nodes: deque[Candidate] = deque()
        self._old_nodes: deque[Candidate] = deque()
        self._tried: Counter[tuple[int, int]] = Counter()
        self._found: Counter[tuple[int, int]] = Counter()
        self._home: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._new_nodes) + len(self._old_nodes)

    def add_candidate(self, node: int, home: int, submap: int, *, new_node: bool) -> None:
        """Put a candidate into the queue.

        Args:
            node: index.
            home: index of the submap that the node was inserted into.
            submap: index of the submap in which the node is searched for.
            new_node: whether the node is new, and not the submap.
        """
        self._home[node] = home
        queue = self._new_nodes if new_node else self._old_nodes
        queue.append((node, submap))
        if len(queue) > self.config.max_num_candidates:
            queue.popleft()
            self.dropped += 1

    def next_candidate(self) -> Candidate | None:
        """Take the next candidate out of the queue; None where none is worth a search."""
        c = self.config
        while self._new_nodes or self._old_nodes:
            node, submap = self._new_nodes.pop() if self._new_nodes else self._old_nodes.popleft()
            pair = self._home[node], submap
            if self._found[pair] < c.found_per_pair and self._tried[pair] < c.tries_per_pair:
                return node, submap
        return None

    def record_result(self, node: int, submap: int, *, found: bool) -> None:
        """Count a search and its success."""
        pair = self._home[node], submap
        self._tried[pair] += 1
        self._found[pair] += found
