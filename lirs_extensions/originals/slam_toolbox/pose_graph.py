"""Pose graph of the original (Konolige et al. 2010); the odometry is no constraint."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from lirs_extensions.originals.cartographer.scan_matching import NormalEquations, SolverOptions, minimize
from lirs_extensions.originals.slam_toolbox.config import SlamToolboxOriginalConfig
from lirs_extensions.originals.slam_toolbox.scan_matching import CorrelativeMatcher, ScanNode, SensorMatch
from lirs_wct.geometry import FloatArray, Pose2, in_axes_of, wrap_angles
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.cartographer.pose_graph import PoseConstraint, PoseConstraints, errors, linearize

SOLVER = SolverOptions(1e-3, 1e-6, 1e-3, max_radius=1e8, nonmonotonic=3)
"""Options with which the original calls Ceres."""
ITERATIONS = 50
TOLERANCE = 1e-6
"""Rounding that comparisons of squared distances allow for, square meters."""


class SlamToolboxGraph:
    """Nodes with their links; counts loop searches and optimizations."""

    def __init__(self, config: SlamToolboxOriginalConfig) -> None:
        self._config = c = config
        self.matcher, self.loop_matcher = CorrelativeMatcher(c, "correlation"), CorrelativeMatcher(c, "loop")
        self.nodes: list[ScanNode] = []
        self.links: dict[tuple[int, int], PoseConstraint] = {}
        self.events: list[LoopEvent] = []
        self.loop_searches = 0
        self._neighbors: list[list[int]] = []
        self._solution: list[FloatArray] = []

    def add_node(self, node: ScanNode, match: SensorMatch | None, running: Sequence[int]) -> None:
        """Add a node, link it, and move it to the mean of its matches."""
        new = len(self.nodes)
        self.nodes.append(node)
        self._neighbors.append([])
        self._solution.append(node.pose.as_array())
        if match is None:
            return
        self._link(new - 1, new, match)
        matches = [match]
        self._link_chain(running, new, match)
        for chain in self._near_chains(new):
            found = self.matcher.match(node, [self.nodes[i] for i in chain], node.sensor)
            if found.response > self._config.link_match_minimum_response_fine - TOLERANCE:
                matches.append(found)
                self._link_chain(chain, new, found)
        node.place(node.base_at(weighted_mean(matches)))

    def close_loops(self, new: int) -> None:
        """Match a node with each chain of old ones near it; optimize after a success."""
        c, node = self._config, self.nodes[new]
        chain, start = self._loop_chain(new, 0)
        while chain:
            self.loop_searches += 1
            base = [self.nodes[i] for i in chain]
            match = self.loop_matcher.match(node, base, node.sensor, fine=False)
            deviation = math.sqrt(max(match.covariance[0, 0], match.covariance[1, 1]))
            if (
                match.response > c.loop_match_minimum_response_coarse
                and deviation < c.loop_match_maximum_variance_coarse
            ):
                match = self.matcher.match(node, base, match.sensor)
                if match.response >= c.loop_match_minimum_response_fine:
                    before, pose = node.pose, node.base_at(match.sensor)
                    self.events.append(LoopEvent(node.stamp, base[0].stamp, before, pose, match.response))
                    node.place(pose)
                    self._link_chain(chain, new, match)
                    self._optimize()
            chain, start = self._loop_chain(new, start)

    def _link(self, old: int, new: int, match: SensorMatch) -> None:
        """Link two nodes, unless they are linked."""
        if (old, new) in self.links:
            return
        frame = self.nodes[old].pose
        z = frame.inverse() @ self.nodes[new].base_at(match.sensor)
        information = np.asarray(np.linalg.inv(in_axes_of(frame, match.covariance)), dtype=np.float64)
        self.links[old, new] = PoseConstraint(old, new, z.as_array(), information, False)
        self._neighbors[old].append(new)
        self._neighbors[new].append(old)

    def _link_chain(self, chain: Sequence[int], new: int, match: SensorMatch) -> None:
        """Link a node to the nearest of a chain, if near enough."""
        distances = [self._squared_distance(i, new) for i in chain]
        nearest = int(np.argmin(distances))
        if distances[nearest] < self._config.link_scan_maximum_distance**2 + TOLERANCE:
            self._link(chain[nearest], new, match)

    def _squared_distance(self, a: int, b: int) -> float:
        (ax, ay), (bx, by) = self.nodes[a].center, self.nodes[b].center
        return (ax - bx) ** 2 + (ay - by) ** 2

    def _reach(self, new: int, reach: float) -> list[int]:
        """Return the nodes near a node that links through near nodes reach, breadth first."""
        queue, known, found = deque([new]), {new}, []
        while queue:
            i = queue.popleft()
            if self._squared_distance(i, new) <= reach**2 - TOLERANCE:
                found.append(i)
                fresh = [k for k in self._neighbors[i] if k not in known]
                known.update(fresh)
                queue.extend(fresh)
        return found

    def _near_chains(self, new: int) -> list[list[int]]:
        """Return runs of consecutive nodes near a node, each around a linked one, without it."""
        c, used, chains = self._config, set[int](), list[list[int]]()

        def is_near(i: int) -> bool:
            return self._squared_distance(i, new) < c.link_scan_maximum_distance**2 + TOLERANCE

        for i in self._reach(new, c.link_scan_maximum_distance):
            if i == new or i in used:
                continue
            before, after = range(i - 1, -1, -1), range(i + 1, new + 1)
            chain = [*reversed([*takewhile(is_near, before)]), i, *takewhile(is_near, after)]
            used.update(chain)
            if new not in chain and len(chain) >= c.loop_match_minimum_chain_size:
                chains.append(chain)
        return chains

    def _loop_chain(self, new: int, start: int) -> tuple[list[int], int]:
        """Return the next run of near nodes that no links reach, and the node after it."""
        c, chain = self._config, list[int]()
        linked = set(self._reach(new, c.loop_search_maximum_distance))
        for i in range(start, len(self.nodes)):
            if self._squared_distance(i, new) < c.loop_search_maximum_distance**2 + TOLERANCE:
                if i in linked:
                    chain.clear()
                else:
                    chain.append(i)
            elif len(chain) >= c.loop_match_minimum_chain_size:
                return chain, i
            else:
                chain.clear()
        return chain, len(self.nodes)

    def _optimize(self) -> None:
        """Move all nodes but the first to the solution, from the last one on."""
        x = np.array(self._solution)
        problem = _GraphProblem(x[0], PoseConstraints.stack(list(self.links.values())))
        x[1:] = minimize(problem, x[1:].ravel(), ITERATIONS, options=SOLVER, move=_take_step).reshape(-1, 3)
        self._solution = list(x)
        for node, pose in zip(self.nodes, x.tolist(), strict=True):
            node.place(Pose2(*pose))


def weighted_mean(matches: Sequence[SensorMatch]) -> Pose2:
    """Return the mean of the matches by their covariances; headings count alike."""
    informations = [np.linalg.inv(match.covariance) for match in matches]
    mean = np.linalg.inv(sum(informations, np.zeros((3, 3)))) @ sum(
        (W @ m.sensor.as_array() for W, m in zip(informations, matches, strict=True)), np.zeros(3)
    )
    heading = np.angle(sum(np.exp(1j * match.sensor.yaw) for match in matches))
    return Pose2(float(mean[0]), float(mean[1]), float(heading))


def _take_step(x: FloatArray, step: FloatArray) -> FloatArray:
    """Return the poses (3 n,) after a step, their headings wrapped."""
    moved = x + step
    moved[2::3] = wrap_angles(moved[2::3])
    return moved


@dataclass(frozen=True)
class _GraphProblem:
    """Least-squares problem over all nodes but the first (3,)."""

    first: FloatArray
    links: PoseConstraints

    def evaluate(self, x: FloatArray) -> NormalEquations:
        """Return the normal equations."""
        links, poses = self.links, np.vstack((self.first, x.reshape(-1, 3)))
        e = errors(poses[links.a], poses[links.b], links.z)
        cost = 0.5 * float(np.einsum("mi,mij,mj->", e, links.information, e))
        blocks, gradient = np.zeros((len(poses), 3, 3)), np.zeros((len(poses), 3))
        cross = np.empty((len(links.a), 3, 3))
        linearize(links, poses, poses, 1.0, (blocks, gradient), (blocks, gradient), cross)
        a, b, own = links.a, links.b, np.arange(len(poses))
        rows, cols = np.concatenate((own, a, b)), np.concatenate((own, b, a))
        values = np.concatenate((blocks, cross, cross.transpose(0, 2, 1)))
        i = np.repeat(3 * rows, 9).reshape(-1, 3, 3) + np.arange(3)[:, None]
        j = np.repeat(3 * cols, 9).reshape(-1, 3, 3) + np.arange(3)
        H = sparse.csc_matrix((values.ravel(), (i.ravel(), j.ravel())))[3:, 3:]
        return NormalEquations(cost, gradient[1:].ravel(), H.diagonal(), H)

    def solve(self, equations: NormalEquations, damping: FloatArray) -> FloatArray:
        """Return the damped step."""
        H = sparse.csc_matrix(equations.hessian + sparse.diags(damping))
        factors = splu(H, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        step: FloatArray = -factors.solve(equations.gradient)
        return step
