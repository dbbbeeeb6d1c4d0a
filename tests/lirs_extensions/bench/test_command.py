"""`bench` from end to end: one score, a table with what ran before, resuming; what is wrong in one line."""

import json
from pathlib import Path
from typing import Any

import pytest

from lirs_extensions.bench.episode import RECORD

TASK = {
    "task": "navigation",
    "split": "test",
    "world": "plan",
    "robot": "jackal",
    "seed": 1,
    "start": [-2, -6, 0],
    "time_limit": 30,
}
SET: dict[str, Any] = {
    "schema": 1,
    "name": "mine",
    "version": 1,
    "worlds": {
        "plan": {"maker": "floor plan", "seed": 0},
        "depot": {
            "maker": "files",
            "files": [{"sha256": "ab" * 32, "size": 124, "origin": "some/where/depot.yaml"}],
        },
    },
    "tasks": [
        TASK | {"name": "ahead", "goal": [0.5, -6]},
        TASK | {"name": "behind", "goal": [-6, -6]},
        TASK | {"name": "elsewhere", "goal": [-6, -6], "world": "depot"},
    ],
}
POLICIES = """
import numpy as np

class Ahead:
    def reset(self, info): pass
    def act(self, observation): return np.array([1.0, 0.0])

class NotBehind(Ahead):
    def act(self, observation):
        if abs(observation["goal"][1]) > 2:
            raise RuntimeError("never turns")
        return np.array([1.0, 0.0])
"""


@pytest.fixture
def bench(wct: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    (tmp_path / "mine.json").write_text(json.dumps(SET))
    (tmp_path / "my_policies.py").write_text(POLICIES)
    monkeypatch.delitem(__import__("sys").modules, "my_policies", raising=False)
    return lambda *arguments: wct("bench", *arguments, "--set", "mine.json", "-o", "out")


def test_a_policy_has_one_score_beside_what_ran_before(bench: Any, tmp_path: Path) -> None:
    code, said, told = bench("straight", "--pictures")
    assert code == 0
    first = json.loads((tmp_path / "out" / "scores-mine-navigation-test.json").read_text())["policies"][0]
    score = first["score"]
    assert f" straight  {score['mean']:.3f}  {score['low']:.3f}, {score['high']:.3f} " in said
    assert said.endswith("straight reaches 1 of 2 goals in mine (test).\n")
    assert score["mean"] == sum(first["tasks"].values()) / 2
    assert "skipped 1 tasks in depot: no --data folder is given: some/where/depot.yaml (sha256 abab" in told
    pictures = sorted((tmp_path / "out").glob("*/episode.png"))
    assert len(pictures) == 2

    code, said, told = bench("straight", "my_policies:Ahead", "astar")
    assert code == 0
    assert "my_policies:Ahead - straight: +0.000 [0.000, 0.000], paired over 2 tasks" in said
    assert "astar - straight: +0.5" in said
    assert "straight - straight" not in said
    rows = [line.split()[0] for line in said.splitlines() if line.startswith((" astar", " my_", " straight"))]
    assert rows[0] == "astar*"
    assert set(rows) == {"astar*", "my_policies:Ahead", "straight"}
    scores = json.loads((tmp_path / "out" / "scores-mine-navigation-test.json").read_text())
    by_name = {entry["policy"]: entry for entry in scores["policies"]}
    assert by_name["straight"]["tasks"] == by_name["my_policies:Ahead"]["tasks"]
    assert by_name["straight"]["tasks"]["behind"] == 0.0 < by_name["straight"]["tasks"]["ahead"]
    assert by_name["straight"]["of_astar"] < 0.6 < by_name["astar"]["score"]["mean"]


def test_the_same_command_runs_nothing_twice_and_a_cut_off_record_again(bench: Any, tmp_path: Path) -> None:
    bench("straight")
    records = sorted((tmp_path / "out").glob(f"*/{RECORD}"))
    before = {path: path.stat().st_mtime_ns for path in records}
    code, _, told = bench("straight")
    assert (code, len(records)) == (0, 2)
    assert "kept 2 of 2 from before" in told
    records[0].write_text(records[0].read_text()[:100])
    code, said, told = bench("straight")
    assert code == 0
    assert "kept 1 of 2 from before; 1 to run" in told
    assert records[0].stat().st_mtime_ns > before[records[0]]
    assert records[1].stat().st_mtime_ns == before[records[1]]
    assert "straight reaches 1 of 2 goals in mine (test)." in said


def test_a_policy_that_fails_costs_its_own_episode(bench: Any, tmp_path: Path) -> None:
    code, said, told = bench("my_policies:NotBehind")
    assert code == 3
    assert "my_policies:NotBehind failed on behind: act(observation) raised RuntimeError: never turns" in told
    entries = {
        e["task"]["name"]: e
        for e in map(json.loads, (p.read_text() for p in (tmp_path / "out").glob(f"*/{RECORD}")))
    }
    assert entries["ahead"]["metrics"]["score"] > 0.8
    assert entries["behind"]["metrics"]["score"] == 0.0
    assert "my_policies:NotBehind reaches 1 of 2 goals in mine (test)." in said
    (trace,) = (tmp_path / "out").glob("*/error.txt")
    assert "my_policies.py" in trace.read_text()
    # Mended, it is run again without being asked for.
    (tmp_path / "my_policies.py").write_text(POLICIES.replace("> 2", "> 4.0"))
    __import__("sys").modules.pop("my_policies")
    code, _, told = bench("my_policies:NotBehind")
    assert code == 0
    assert "failed" not in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere:Policy",), "policy 'nowhere:Policy': no module 'nowhere' is installed or in "),
        (("my_policies:Behind",), "my_policies has no class 'Behind'; classes with act: Ahead, NotBehind"),
        (
            ("fastest",),
            "unknown policy 'fastest'; legal: astar, frontier, go_to_goal, module:name of your own",
        ),
        (
            ("straight", "--task", "mapping"),
            "the set mine has no mapping tasks in the split test; it has navigation",
        ),
        (("straight", "--split", "exam"), "unknown split 'exam'"),
        (("straight", "--data", "nowhere"), "nowhere: no such folder"),
        (("straight", "--parameters", "a=1"), "--parameters are for policies of your own"),
        (("my_policies:Ahead", "--parameters", "a"), "--parameters must be NAME=VALUE,NAME=VALUE,..."),
        (("my_policies:Ahead", "--parameters", "a=1"), "takes no parameter 'a'; it takes none"),
        (("straight", "--jobs", "0"), "jobs must be at least 1"),
    ],
)
def test_bad_input_is_one_line_and_nothing_runs(
    arguments: tuple[str, ...], message: str, bench: Any, tmp_path: Path
) -> None:
    code, said, told = bench(*arguments)
    assert code == 2
    line = told.strip().splitlines()[-1]
    assert line.startswith("lirs-wct: ")
    assert message in line
    assert said == ""
    assert not (tmp_path / "out").exists()
