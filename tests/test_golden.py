"""benchmarks/golden.py notices every change, and lets pass only what 1.0.0 has or lacks by name."""

from copy import deepcopy
from typing import Any

import pytest

from benchmarks.golden import compare

BEFORE: dict[str, Any] = {
    "runs/map.pgm": "0" * 64,
    "runs/record.json": {"map": {"f1": 0.9}, "poses": [1, 2], "config": {"seed": 1}},
    "envs/a": {"step 001": {"reward": 1.0}},
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("runs/map.pgm",), "1" * 64),
        (("runs/record.json", "map", "f1"), 0.8),
        (("runs/record.json", "map", "iou"), 0.5),
        (("runs/record.json", "poses"), [1, 2, 3]),
        (("envs/a", "step 001", "info.score"), 1),
        (("envs/b",), {}),
    ],
)
def test_a_change_is_noticed_either_way(path: tuple[str, ...], value: Any) -> None:
    now = deepcopy(BEFORE)
    place: Any = now
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert compare(BEFORE, now) == compare(now, BEFORE) == 1


def test_records_of_1_0_0_compare_with_later_ones(capsys: pytest.CaptureFixture[str]) -> None:
    old, now = deepcopy(BEFORE), deepcopy(BEFORE)
    old["runs/record.json"] |= {"config": {"seed": 1, "threads": 2, "bag": "mcap"}, "file_sizes": {"a": 1}}
    now["runs/record.json"]["config"]["time"] = "log"
    now["envs/a"]["step 001"]["info.is_success"] = False
    assert compare(old, now) == 0
    assert compare(now, old) == 2  # a key that is new may not vanish
    assert "config.time: log -> absent" in capsys.readouterr().out
