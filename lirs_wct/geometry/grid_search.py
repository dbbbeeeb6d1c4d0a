"""Shortest paths over the cells of a grid (Dijkstra 1959), with an early stop."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit


@dataclass(frozen=True)
class Reach:
    """The result of a search.

    Attributes:
        cost: (rows, cols) cost from the sources in meters times weight; inf = not reached.
        parent: (rows, cols) flat index of the predecessor; -1 at a source.
    """

    cost: FloatArray
    parent: IntArray

    def path(self, cell: tuple[int, int]) -> IntArray:
        """Return (n, 2) rows and columns from a source to a reached cell, both included."""
        cols = self.parent.shape[1]
        flat = cell[0] * cols + cell[1]
        chain = [flat]
        parents = self.parent.ravel()
        while parents[flat] >= 0:
            flat = int(parents[flat])
            chain.append(flat)
        return np.stack(np.divmod(np.array(chain[::-1], dtype=np.int64), cols), axis=-1)


def search(
    weight: FloatArray,
    sources: IntArray,
    resolution: float,
    *,
    goals: BoolArray | None = None,
    slack: float = 0.0,
    limit: float = math.inf,
) -> Reach:
    """Search from sources to the eight neighbors of each cell; paths cut no blocked corners.

    Args:
        weight: (rows, cols) cost of a meter in each cell; inf = blocked.
        sources: (n, 2) rows and columns where the cost is 0.
        resolution: meters a cell.
        goals: stop when all cells up to `slack` beyond the nearest goal are settled.
        slack: extra cost beyond the nearest goal, in units of the cost.
        limit: stop at this cost.
    """
    wanted = np.zeros(weight.shape, np.bool_) if goals is None else goals
    cost, parent = np.full(weight.shape, np.inf), np.full(weight.shape, -1)
    weight = np.ascontiguousarray(weight, dtype=np.float64)
    settled = _dijkstra(weight, sources, resolution, wanted, slack, limit, cost, parent)
    cost[cost > settled] = np.inf  # that of a cell that is not settled is not yet minimal
    return Reach(cost, parent)


@njit
def _dijkstra(
    weight: FloatArray, sources: IntArray, resolution: float, goals: BoolArray, slack: float, limit: float,
    cost: FloatArray, parent: IntArray,
) -> float:  # fmt: skip
    """Fill `cost` and `parent` (rows, cols); return the cost up to which cells are settled."""
    rows, cols = weight.shape
    heap = [(0.0, np.int64(-1))]
    heap.pop()
    for k in range(len(sources)):
        r, c = sources[k, 0], sources[k, 1]
        if cost[r, c] > 0 and weight[r, c] < np.inf:
            cost[r, c] = 0.0
            heapq.heappush(heap, (0.0, r * cols + c))
    while len(heap) > 0:
        here, flat = heapq.heappop(heap)
        r, c = flat // cols, flat % cols
        if here > cost[r, c]:
            continue
        if here > limit:
            break
        if goals[r, c]:
            limit = min(limit, here + slack)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                i, j = r + dr, c + dc
                if (dr == 0 and dc == 0) or i < 0 or j < 0 or i >= rows or j >= cols:
                    continue
                if weight[i, j] == np.inf or weight[r, j] == np.inf or weight[i, c] == np.inf:
                    continue
                step = resolution * (1.4142135623730951 if dr != 0 and dc != 0 else 1.0)
                there = here + step * 0.5 * (weight[r, c] + weight[i, j])
                if there < cost[i, j]:
                    cost[i, j] = there
                    parent[i, j] = flat
                    heapq.heappush(heap, (there, i * cols + j))
    return limit
