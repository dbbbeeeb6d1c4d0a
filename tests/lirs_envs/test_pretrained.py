"""The policy whose weights ship: its network, its inputs, its steering."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.policies import PolicyContext
from lirs_envs.pretrained import (
    FEATURES,
    GOALWARD,
    HEADINGS,
    SCAN_SECTORS,
    HeadingSteering,
    Pretrained,
    evaluate,
    initial_memory,
    load_weights,
    read_weights,
)
from lirs_wct.errors import SourceError

CONTEXT = PolicyContext.of(EnvConfig(robot="jackal"))


def observation(bearing: float = 0.0, distance: float = 5.0, **walls: float) -> dict[str, Any]:
    """A scan without hits but for one beam at `angle` and `range`."""
    lidar = CONTEXT.lidar
    scan = np.full(lidar.beams, lidar.range_max, np.float32)
    if walls:
        scan[np.argmin(np.abs(lidar.angles - walls["angle"]))] = walls["range"]
    return {"scan": scan, "goal": np.array((distance, bearing)), "odometry": np.zeros(3)}


def torch_scores(torch: Any, weights: Any, inputs: Any) -> Any:
    """Evaluate the network with torch's own layers, over whole episodes."""
    state = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
    units = state["memory.weight_hh"].shape[1]
    gru = torch.nn.GRU(units, units, batch_first=True)
    gru.load_state_dict({f"{k.split('.')[1]}_l0": v for k, v in state.items() if k.startswith("memory")})

    def linear(name: str, x: Any) -> Any:
        return torch.nn.functional.linear(x, state[f"{name}.weight"], state[f"{name}.bias"])

    with torch.no_grad():
        x = torch.relu(linear("encoder", torch.from_numpy(inputs)))
        kept, _ = gru(x)
        return linear("head", torch.relu(linear("mixer", torch.cat((x, kept), dim=-1)))).numpy()


def numpy_scores(weights: Any, inputs: Any) -> Any:
    memory, found = initial_memory(weights, len(inputs)), []
    for k in range(inputs.shape[1]):
        scores, memory = evaluate(weights, inputs[:, k], memory)
        found.append(scores)
    return np.stack(found, axis=1)


def test_numpy_gives_the_scores_of_torch() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed (extra [rl])")
    inputs = np.random.default_rng(0).uniform(-1, 1, (4, 50, FEATURES)).astype(np.float32)
    weights = load_weights()
    found = numpy_scores(weights, inputs)
    np.testing.assert_allclose(found, torch_scores(torch, weights, inputs), rtol=0, atol=1e-5)


def test_the_shipped_weights_give_the_stored_scores() -> None:
    """The values were those of torch."""
    stored = np.load(Path(__file__).parent / "pretrained_scores.npy")
    inputs = np.random.default_rng(1).uniform(0, 1, (1, 5, FEATURES)).astype(np.float32)
    np.testing.assert_allclose(numpy_scores(load_weights(), inputs)[0], stored, rtol=0, atol=1e-5)


def test_inputs_turn_with_the_goal() -> None:
    steering = HeadingSteering(CONTEXT)
    for bearing in (0.0, 1.0, -2.0):
        steering.reset({})
        near = steering.features(observation(bearing, angle=0.5, range=2.0))[:SCAN_SECTORS]
        x = 2.0 * math.cos(0.5) + CONTEXT.robot.T_base_laser.position[0]
        angle, distance = math.atan2(2.0 * math.sin(0.5), x), math.hypot(x, 2.0 * math.sin(0.5))
        sector = int(((angle - bearing) / math.tau + 0.5) % 1 * SCAN_SECTORS)
        assert int(np.argmax(near)) == sector
        assert near[sector] == pytest.approx(1 / (1 + distance), abs=0.01)


@pytest.mark.parametrize("side", [-1, 1])
def test_steering_follows_the_chosen_heading(side: int) -> None:
    steering = HeadingSteering(CONTEXT)
    steering.choose(GOALWARD + side * HEADINGS // 4, observation())
    assert steering.act(observation())[1] * side > 0.2
    steering.choose(GOALWARD, observation())
    speed, turn = steering.act(observation()).tolist()
    assert speed == pytest.approx(0.5)  # 1 m/s of 2 m/s
    assert abs(turn) < 0.1


def test_choices_are_due_every_0_4_m_at_full_speed() -> None:
    policy = Pretrained(CONTEXT)
    policy.reset({})
    due = []
    for _ in range(9):
        due.append(policy.due)
        policy.act(observation())
    assert due == [k % 4 == 0 for k in range(9)]
    slow = HeadingSteering(replace(CONTEXT, robot=replace(CONTEXT.robot, max_speed=0.1)))
    slow.choose(GOALWARD, observation())
    steps = 0
    while not slow.due:
        slow.act(observation())
        steps += 1
    assert steps == 12


@pytest.mark.slow
def test_it_reaches_a_goal_in_another_room() -> None:
    """Task of the split `validation`: the straight line to the goal is blocked."""
    from lirs_extensions.bench.episode import run_episode
    from lirs_extensions.bench.policies import PolicyChoice
    from lirs_extensions.bench.tasks import task_set

    tasks = [t for t in task_set("indoor").chosen("navigation", "validation") if t.robot == "jackal"]
    ended = [run_episode(task, PolicyChoice("pretrained")).reason for task in tasks if not task.world.files]
    assert ended.count("success") >= 3


def test_a_file_that_holds_no_weights_is_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    with pytest.raises(SourceError, match=r"mine\.npz: cannot be read"):
        read_weights(path)
    path.write_bytes(b"no archive")
    with pytest.raises(SourceError, match=r"mine\.npz: not weights"):
        read_weights(path)
    np.savez(path, **{"encoder.weight": np.zeros(3)})
    with pytest.raises(SourceError, match=r"mine\.npz: not weights"):
        read_weights(path)
