"""Train the policy that ships: a recurrent network imitates the shortest route, which it does not see.

    python examples/train_pretrained.py [--minutes 60] [--seed 0] [-o FOLDER]

The same command resumes. FOLDER gets `navigation.npz`, `curve.csv` and the training's state. Needs torch.
The method is DAgger (Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction
to no-regret online learning", 2011): in each round the network drives robots through new worlds, the true map
labels each of its choices with the direction of the shortest route, and the network learns from all rounds.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from flat_robots import FlatRobots

from lirs_envs.policies import HORIZON, PolicyContext
from lirs_envs.pretrained import (
    FEATURES,
    GOALWARD,
    HEADINGS,
    PATH_SECTORS,
    SCAN_SECTORS,
    HeadingSteering,
    Weights,
    evaluate,
    initial_memory,
)
from lirs_envs.tasks.site import Site
from lirs_envs.vector_env import RobotVectorEnv
from lirs_extensions.bench.episode import success_by_path_length
from lirs_extensions.bench.tasks import WorldSpec
from lirs_wct.arrays import FloatArray, njit

try:
    import torch
except ImportError:
    raise SystemExit("needs torch: pip install 'lirs-wct[rl]'") from None

FOLDER = Path("out/pretrained")
FLOOR_ROBOTS = ("jackal", "turtlebot2", "turtlebot3_waffle")
KINDS = (
    ("jackal", "floor plan", {}),
    ("jackal", "course", {"kind": "mazes", "difficulty": 0.75}),
    ("husky", "boulders", {}),
    ("turtlebot2", "floor plan", {}),
    ("jackal", "natural", {"kind": "hills"}),
    ("husky", "course", {"kind": "stones", "difficulty": 0.75}),
    ("turtlebot3_waffle", "floor plan", {}),
    ("husky", "natural", {"kind": "dunes"}),
)
"""Robot, maker of its worlds and options of a round with physics, in turn."""
PHYSICS_EVERY = 8
"""Rounds, of which the last has physics."""
ROUND_SECONDS, SECONDS = 80.0, {"turtlebot3_waffle": 140.0}
"""Seconds of a round, and those of slow robots."""
FIRST_SEED = 1000
"""Least seed of a world to train on; the benchmark's are smaller."""
WORLDS, ROBOTS = 16, 16
CONTROL_HZ = 5.0
EXPERT_ROUNDS, EXPERT_SHARE = 6, 0.1
"""Rounds in which ever fewer episodes are driven by the labels, and their share afterwards."""
SPREAD = math.radians(8)
"""Standard deviation of a label, radians."""
UNITS = 128
BATCH, BATCHES = 24, 36
"""Episodes in a batch, and batches a round."""
ROUNDS, LAST_BATCHES = 40, 300
"""Rounds of the training that ships, and batches after them, in which the learning rate falls to 0."""
RATE = 1e-3
"""Learning rate of the first round."""
MIRROR = np.array((1, -1, 1, 1, 1, -1, 1, -1, 1, 1, 1, 1, 1), np.float32)
"""Signs of the inputs after the sectors where left and right are exchanged."""
REASONS = ("success", "collision", "time", "tipped over", "left the world")

Episode = tuple[Any, Any]
"""Inputs and labels."""


@dataclass
class Recording:
    """Choices of an episode.

    Attributes:
        expert: whether the labels drove it.
        features: inputs of the network, one row a choice.
        labels: direction of the route off that of the goal, radians.
        driven: length of the driven path, meters.
        reason: reason for the end; empty = it was cut off.
        score: success weighted by path length.
    """

    expert: bool
    features: list[Any] = field(default_factory=list)
    labels: list[float] = field(default_factory=list)
    driven: float = 0.0
    reason: str = ""
    score: float = 0.0


class Route:
    """Shortest route over the true map to a goal.

    Args:
        site: free ground of the robot.
        goal: x, y, meters.

    Attributes:
        goal: the goal.
    """

    def __init__(self, site: Site, goal: FloatArray) -> None:
        self._grid, self.goal = site.grid, goal
        self._costs = site.distances(*goal.tolist())

    def direction(self, place: FloatArray) -> float:
        """Return the direction of the farthest point of the route in sight within 4 m, radians."""
        origin, cell = self._grid.origin, self._grid.resolution
        here, goal = origin.inverse().apply(np.array((place, self.goal))) / cell
        dx, dy = (_aim(self._costs, here, goal, HORIZON / cell) - here).tolist()
        return math.atan2(dy, dx) + origin.yaw


@njit(cache=True, nogil=True)
def _aim(costs: FloatArray, here: FloatArray, goal: FloatArray, reach: float) -> FloatArray:
    """Return the farthest point in sight of the steepest descent of path lengths, in cells."""
    rows, cols = costs.shape
    r, c = _nearest(costs, here)
    aim, gone = np.array((c + 0.5, r + 0.5)), 0.0
    while gone < reach:
        least, r1, c1 = costs[r, c], r, c
        for i in range(max(r - 1, 0), min(r + 2, rows)):
            for j in range(max(c - 1, 0), min(c + 2, cols)):
                if costs[i, j] < least - 1e-9 and costs[r, j] < np.inf and costs[i, c] < np.inf:
                    least, r1, c1 = costs[i, j], i, j
        if r1 == r and c1 == c:
            return goal if _sees(costs, here, goal) else aim
        gone += math.hypot(r1 - r, c1 - c)
        r, c = r1, c1
        if _sees(costs, here, np.array((c + 0.5, r + 0.5))):
            aim = np.array((c + 0.5, r + 0.5))
    return aim


@njit(cache=True, nogil=True)
def _nearest(costs: FloatArray, here: FloatArray) -> tuple[int, int]:
    """Return the cell with a path nearest to a point."""
    r0 = min(max(int(here[1]), 0), costs.shape[0] - 1)
    c0 = min(max(int(here[0]), 0), costs.shape[1] - 1)
    best, r, c = np.inf, r0, c0
    for i in range(max(r0 - 4, 0), min(r0 + 5, costs.shape[0])):
        for j in range(max(c0 - 4, 0), min(c0 + 5, costs.shape[1])):
            away = math.hypot(i + 0.5 - here[1], j + 0.5 - here[0])
            if costs[i, j] < np.inf and away < best:
                best, r, c = away, i, j
    return r, c


@njit(cache=True, nogil=True)
def _sees(costs: FloatArray, here: FloatArray, there: FloatArray) -> bool:
    """Return whether a line runs over cells with a path; those around its start do not count."""
    length = math.hypot(there[0] - here[0], there[1] - here[1])
    steps = int(2 * length) + 1
    for k in range(steps + 1):
        at = here + k / steps * (there - here)
        if k / steps * length > 1.5 and costs[int(at[1]), int(at[0])] == np.inf:
            return False
    return True


class Net(torch.nn.Module):
    """The network of `lirs_envs.pretrained.evaluate`, over whole episodes."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = torch.nn.Linear(FEATURES, UNITS)
        self.memory = torch.nn.GRU(UNITS, UNITS, batch_first=True)
        self.mixer = torch.nn.Linear(2 * UNITS, 96)
        self.head = torch.nn.Linear(96, HEADINGS)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return scores (episodes, choices, headings) of inputs (episodes, choices, inputs)."""
        x = torch.relu(self.encoder(features))
        kept, _ = self.memory(x)
        return self.head(torch.relu(self.mixer(torch.cat((x, kept), dim=-1))))

    def weights(self) -> Weights:
        """Return the weights as NumPy's arrays."""
        state = self.state_dict()
        return {name.removesuffix("_l0"): value.numpy().copy() for name, value in state.items()}


def main() -> None:
    """Train."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of this part; the same command resumes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--out", type=Path, default=FOLDER)
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="of the whole training")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    train(given.minutes, given.rounds, given.seed, given.out)


def train(minutes: float, rounds: int, seed: int, folder: Path) -> None:
    """Train up to a number of rounds, some minutes at a time, from where the folder's training stopped."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    net, number, end = Net(), 0, time.monotonic() + 60 * minutes
    optimizer = torch.optim.Adam(net.parameters(), RATE)
    if (folder / "state.pt").exists():
        state = torch.load(folder / "state.pt")
        net.load_state_dict(state["net"])
        optimizer.load_state_dict(state["optimizer"])
        number = state["rounds"]
    episodes = [one for k in range(number) for one in read_round(folder / f"round-{k:04d}.npz")]
    while number < rounds and time.monotonic() < end:
        cpu, rng = time.process_time(), np.random.default_rng((seed, number))
        recorded = drive_round(number, net.weights(), rng)
        write_round(folder / f"round-{number:04d}.npz", recorded)
        episodes += read_round(folder / f"round-{number:04d}.npz")
        rate = RATE / (1 + number / 40)
        loss = fit(net, optimizer, episodes, np.full(BATCHES, rate), rng)
        number += 1
        state = {"net": net.state_dict(), "optimizer": optimizer.state_dict(), "rounds": number}
        torch.save(state, folder / "state.pt")
        np.savez_compressed(folder / "navigation.npz", **net.weights())
        note(folder / "curve.csv", number, recorded, episodes, loss, time.process_time() - cpu)
    if number == rounds:
        rates = RATE / (1 + number / 40) * (1 - np.arange(LAST_BATCHES) / LAST_BATCHES)
        loss = fit(net, optimizer, episodes, rates, np.random.default_rng((seed, number)))
        np.savez_compressed(folder / "navigation.npz", **net.weights())
        print(f"done: loss {loss:.3f}, weights in {folder / 'navigation.npz'}")


def fit(
    net: Net, optimizer: Any, episodes: Sequence[Episode], rates: FloatArray, rng: np.random.Generator
) -> float:
    """Train on random batches, each at its learning rate; return the mean loss."""
    losses = []
    for rate, drawn in zip(
        rates.tolist(), rng.integers(len(episodes), size=(len(rates), BATCH)), strict=True
    ):
        for group in optimizer.param_groups:
            group["lr"] = rate
        losses.append(learn(net, optimizer, [episodes[k] for k in drawn.tolist()], rng.random() < 0.5))
    return float(np.mean(losses))


def note(
    path: Path,
    number: int,
    recorded: Sequence[Recording],
    episodes: Sequence[Episode],
    loss: float,
    cpu: float,
) -> None:
    """Add a round to the learning curve: outcomes of the episodes that the network drove to their ends."""
    own = [one for one in recorded if one.reason and not one.expert]
    robot, maker, _, physics = kind_of(number - 1)
    row = {"round": number, "robot": robot, "world": maker, "physics": int(physics)}
    row |= {"choices": sum(len(labels) for _, labels in episodes)}
    row |= {"processor_s": round(cpu, 1), "loss": round(loss, 4)}
    row |= {"episodes": len(own), "spl": round(sum(one.score for one in own) / max(len(own), 1), 3)}
    row |= {reason: sum(one.reason == reason for one in own) for reason in REASONS}
    first = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(row))
        if first:
            writer.writeheader()
        writer.writerow(row)
    print(" ".join(f"{name} {value}" for name, value in row.items()), flush=True)


def drive_round(number: int, weights: Weights, rng: np.random.Generator) -> list[Recording]:
    """Drive robots through new worlds; return the episodes."""
    robot, maker, options, physics = kind_of(number)
    seconds = SECONDS.get(robot, ROUND_SECONDS)
    worlds = [
        WorldSpec(name=f"{maker}-{s}", maker=maker, options=tuple({**options, "seed": s}.items())).world(None)
        for s in range(FIRST_SEED + WORLDS * number, FIRST_SEED + WORLDS * (number + 1))
    ]
    difficulty, envs = float(rng.uniform(0.5, 1.0)), None
    if physics:
        envs = RobotVectorEnv(
            ROBOTS, "navigation", autoreset_mode="SameStep", world=worlds, robot=robot,
            observe=HeadingSteering.observe, control_hz=CONTROL_HZ, difficulty=difficulty,
            time_limit=1.2 * seconds, threads=1,
        )  # fmt: skip
    else:
        envs = FlatRobots(worlds, robot, ROBOTS, CONTROL_HZ, difficulty, 1.2 * seconds)
    share = max(EXPERT_SHARE, 1 - number / EXPERT_ROUNDS)
    crew = Crew(envs, weights, share, rng)
    for _ in range(round((1 if physics else 2) * seconds * CONTROL_HZ)):
        crew.step()
    envs.close()
    return [one for one in crew.ended + crew.recordings if one.labels]


def kind_of(number: int) -> tuple[str, str, dict[str, Any], bool]:
    """Return robot, maker of worlds and its options of a round, and whether it has physics."""
    turn, k = divmod(number, PHYSICS_EVERY)
    if k == PHYSICS_EVERY - 1:
        return *KINDS[turn % len(KINDS)], True
    return FLOOR_ROBOTS[(number - turn) % len(FLOOR_ROBOTS)], "floor plan", {}, False


class Crew:
    """Robots that the network or the labels drive, and the recordings of their episodes.

    Attributes:
        recordings: of the present episodes.
        ended: of those before.
    """

    def __init__(self, envs: Any, weights: Weights, share: float, rng: np.random.Generator) -> None:
        self._envs, self._weights, self._share, self._rng = envs, weights, share, rng
        flat = isinstance(envs, FlatRobots)
        context = envs.context if flat else PolicyContext.of(envs.episodes.config)
        self._sites = envs.sites if flat else [part.stage.site for part, _ in envs.episodes.places]
        self._steering = [HeadingSteering(context) for _ in range(ROBOTS)]
        self._memory = initial_memory(weights, ROBOTS)
        self.ended: list[Recording] = []
        observed, infos = envs.reset(seed=int(rng.integers(2**31)))
        self._rows, self._places = split(observed), infos["T_world_base"][:, :2]
        self.recordings = [Recording(rng.random() < share) for _ in range(ROBOTS)]
        self._routes = [self._route(i, infos) for i in range(ROBOTS)]

    def _route(self, i: int, infos: Mapping[str, Any]) -> Route:
        return Route(self._sites[i], infos["goal"][i])

    def step(self) -> None:
        """Choose where choices are due, and act."""
        due = [i for i in range(ROBOTS) if self._steering[i].due]
        if due:
            self._choose(due)
        actions = [one.act(row) for one, row in zip(self._steering, self._rows, strict=True)]
        observed, _, terminated, truncated, infos = self._envs.step(np.array(actions))
        over = np.flatnonzero(terminated | truncated).tolist()
        last = infos.get("final_info", infos)["T_world_base"]
        places = np.where((terminated | truncated)[:, None], last[:, :2], infos["T_world_base"][:, :2])
        for record, before, now in zip(self.recordings, self._places, places, strict=True):
            record.driven += float(np.hypot(*(now - before)))
        self._rows, self._places = split(observed), infos["T_world_base"][:, :2]
        for i in over:
            self._end(i, infos)

    def _choose(self, due: list[int]) -> None:
        inputs = np.array([self._steering[i].features(self._rows[i]) for i in due])
        scores, self._memory[due] = evaluate(self._weights, inputs, self._memory[due])
        for i, features, score in zip(due, inputs, scores, strict=True):
            record, steering = self.recordings[i], self._steering[i]
            x, y = self._places[i]
            goal_x, goal_y = self._routes[i].goal
            label = self._routes[i].direction(self._places[i]) - math.atan2(goal_y - y, goal_x - x)
            record.features.append(features)
            record.labels.append(math.remainder(label, math.tau))
            told = (round(label / math.tau * HEADINGS) + GOALWARD) % HEADINGS
            steering.choose(told if record.expert else int(np.argmax(score)), self._rows[i])

    def _end(self, i: int, infos: Mapping[str, Any]) -> None:
        record, final = self.recordings[i], infos["final_info"]
        record.reason = str(final["reason"][i]) or "time"
        record.score = success_by_path_length(
            bool(final["success"][i]), float(final["shortest_path"][i]), record.driven
        )
        self.ended.append(record)
        self.recordings[i] = Recording(self._rng.random() < self._share)
        self._routes[i], self._memory[i] = self._route(i, infos), 0.0
        self._steering[i].reset({})


def split(observed: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the observations of each robot."""
    return [{name: values[i] for name, values in observed.items()} for i in range(ROBOTS)]


def write_round(path: Path, recorded: Sequence[Recording]) -> None:
    """Write the choices of a round's episodes."""
    np.savez(
        path,
        lengths=[len(one.labels) for one in recorded],
        features=np.concatenate([one.features for one in recorded]).astype(np.float16),
        labels=np.concatenate([one.labels for one in recorded]).astype(np.float32),
    )


def read_round(path: Path) -> list[Episode]:
    """Return inputs and labels of a round's episodes."""
    with np.load(path) as held:
        ends = np.cumsum(held["lengths"])[:-1]
        return list(zip(np.split(held["features"], ends), np.split(held["labels"], ends), strict=True))


def learn(net: Net, optimizer: Any, batch: Sequence[Episode], mirror: bool) -> float:
    """Take one step down the cross entropy of a batch; return it."""
    longest = max(len(labels) for _, labels in batch)
    inputs = np.zeros((len(batch), longest, FEATURES), np.float32)
    targets = np.zeros((len(batch), longest, HEADINGS), np.float32)
    for k, (features, labels) in enumerate(batch):
        inputs[k, : len(labels)] = mirrored(features) if mirror else features
        targets[k, : len(labels)] = soft_labels(-labels if mirror else labels)
    scores = torch.log_softmax(net(torch.from_numpy(inputs)), dim=-1)
    loss = -(torch.from_numpy(targets) * scores).sum() / float(targets.sum())
    optimizer.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimizer.step()
    return float(loss.detach())


def mirrored(features: Any) -> Any:
    """Return inputs (n, inputs) with left and right exchanged."""
    sizes = np.cumsum((SCAN_SECTORS, SCAN_SECTORS, PATH_SECTORS))
    near, far, path, scalars = np.split(features, sizes, axis=1)
    return np.concatenate((near[:, ::-1], far[:, ::-1], path[:, ::-1], scalars * MIRROR), axis=1)


def soft_labels(labels: FloatArray) -> FloatArray:
    """Return (n, headings) shares of the headings around labels (n,)."""
    headings = (np.arange(HEADINGS) - GOALWARD) * math.tau / HEADINGS
    off = np.remainder(headings - labels[:, None] + math.pi, math.tau) - math.pi
    share = np.exp(-0.5 * (off / SPREAD) ** 2)
    return share / share.sum(axis=1, keepdims=True)


if __name__ == "__main__":
    main()
