"""Results of a folder: whose scores stand beside each other, and who knew what no robot knows."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.episodes.observations import GROUPS
from lirs_extensions.bench.episode import (
    RECORD,
    EpisodeTask,
    coverage_area,
    distance_share,
    success_by_path_length,
)
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.results import difference_line, read_results, score_of, share_of_bound
from lirs_extensions.bench.tasks import BenchTask, TaskSet
from lirs_validation.sweep.sweep import Outcome

COURSE = BenchTask(
    name="a",
    task="traverse",
    split="test",
    robot="husky",
    seed=1,
    time_limit=3.0,
    course="waves",
    difficulty=0.5,
)
TASKS = (COURSE, replace(COURSE, name="b", seed=2))
OWN = """
class Plain:
    def reset(self, info): ...
    def act(self, observation): ...

class Modest(Plain):
    observe = ("scan", "goal")

class Knowing(Plain):
    observe = ("scan", "their_truth")
"""


@pytest.fixture(autouse=True)
def _own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_policies.py").write_text(OWN)
    monkeypatch.delitem(__import__("sys").modules, "own_policies", raising=False)


def write(out: Path, policy: str, scores: dict[str, float], **changed: Any) -> None:
    """Write records of a policy as the experiment does, with other scores."""
    for task in TASKS:
        if task.name in scores:
            experiment = EpisodeTask(set_name="mine", set_version=1, task=task, policy=PolicyChoice(policy))
            experiment.write_failure(out, Outcome(task=experiment.name, status="ok"))
            path = out / experiment.name / RECORD
            entry = json.loads(path.read_text())
            entry["metrics"]["score"] = scores[task.name]
            path.write_text(json.dumps(entry | changed))


def results(out: Path) -> dict[str, Any]:
    return {r.policy.name: r for r in read_results(out, TaskSet(name="mine", version=1, tasks=TASKS), TASKS)}


def test_the_best_comes_first_and_the_bound_is_shared_over_common_tasks(tmp_path: Path) -> None:
    write(tmp_path, "straight", {"a": 0.1})
    write(tmp_path, "astar", {"a": 0.5, "b": 1.0})
    found = results(tmp_path)
    assert list(found) == ["astar", "straight"]
    assert found["astar"].score.mean == 0.75
    assert share_of_bound(found["straight"], list(found.values())) == pytest.approx(0.2)
    assert share_of_bound(found["straight"], [found["straight"]]) is None


@pytest.mark.parametrize(
    "changed",
    [{"set_version": 2}, {"versions": {"code": "00000000"}}, {"task": COURSE.describe() | {"seed": 9}}],
)
def test_what_does_not_compare_is_left_out(changed: dict[str, Any], tmp_path: Path) -> None:
    write(tmp_path, "straight", {"a": 0.1})
    assert set(results(tmp_path)) == {"straight"}
    write(tmp_path, "straight", {"a": 0.1}, **changed)
    assert results(tmp_path) == {}


def test_who_is_given_the_truth_is_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(GROUPS, "their_truth", replace(GROUPS["height_map"]))
    # Crossing has heights from the truth among its own observations.
    for policy in (
        "straight",
        "go_to_goal",
        "astar",
        "own_policies:Plain",
        "own_policies:Modest",
        "own_policies:Knowing",
    ):
        write(tmp_path, policy, {"a": 0.1})
    marked = {name for name, result in results(tmp_path).items() if result.privileged}
    assert marked == {"astar", "own_policies:Plain", "own_policies:Knowing"}


def test_differences_are_paired_over_common_tasks(tmp_path: Path) -> None:
    write(tmp_path, "straight", {"a": 0.1, "b": 0.7})
    write(tmp_path, "astar", {"a": 0.3, "b": 0.9})
    write(tmp_path, "random", {"b": 0.4})
    found = results(tmp_path)
    line = difference_line(found["astar"], found["straight"])
    assert line == "astar - straight: +0.200 [0.200, 0.200], paired over 2 tasks"
    assert difference_line(found["random"], found["straight"]).startswith("random - straight: -0.300")
    del found["random"].episodes["b"]
    assert difference_line(found["random"], found["straight"]) == "random - straight: no common tasks"


def test_spl_is_the_shortest_way_over_the_driven_one() -> None:
    assert success_by_path_length(True, 6.0, 8.0) == pytest.approx(0.75)
    assert success_by_path_length(True, 6.0, 5.8) == 1.0  # cells make the shortest way a little long
    assert success_by_path_length(False, 6.0, 6.0) == 0.0


def test_coverage_area_of_a_ramp() -> None:
    # 0.15 at first; at 10 of 40 m all of what is wanted (0.95): half of 10 m, then 30 m in full.
    assert coverage_area([0.0, 10.0], [0.15, 0.95], 40.0) == pytest.approx(35 / 40)
    # Half of it at 20 m, and nothing after.
    assert coverage_area([0.0, 20.0], [0.15, 0.55], 40.0) == pytest.approx((5 + 10) / 40)

    # Ground that is seen without driving counts from the start; driving beyond the budget does not.
    assert coverage_area([0.0, 0.0], [0.15, 0.55], 40.0) == pytest.approx(0.5)

    assert coverage_area([0.0, 10.0, 40.0], [0.15, 0.15, 0.15], 40.0) == 0.0
    assert coverage_area([0.0, 40.0, 41.0], [0.15, 0.15, 0.95], 40.0) == pytest.approx(0.0, abs=1e-12)

    assert coverage_area([0.0, 0.0, 0.0], [0.3, 0.3, 0.3], 10.0) == 0.0


def test_distance_share_is_within_0_and_1() -> None:
    assert distance_share(5.0, 20.0) == 0.25
    assert distance_share(-3.0, 20.0) == 0.0
    assert distance_share(21.0, 20.0) == 1.0


def test_a_score_has_an_interval_that_is_the_same_each_time() -> None:
    values = np.random.default_rng(3).random(40).tolist()
    score = score_of(values)
    assert score == score_of(values)
    assert score.low is not None
    assert score.high is not None
    assert score.low < score.mean < score.high
    # The normal approximation of the bootstrap's width.
    assert score.high - score.low == pytest.approx(2 * 1.96 * np.std(values) / np.sqrt(40), rel=0.1)


def test_scores_of_one_and_of_equal_tasks() -> None:
    one, equal = score_of([0.4]), score_of([0.0, 0.0])
    assert (one.low, one.count) == (None, 1)
    assert (equal.low, equal.high) == (0.0, 0.0)


def test_the_interval_covers_the_mean_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(60):
        score = score_of((rng.random(30) < 0.6).astype(float).tolist())
        assert score.low is not None
        assert score.high is not None
        covered += score.low <= 0.6 <= score.high
    assert covered >= 50
