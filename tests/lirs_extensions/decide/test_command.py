"""`lirs-wct verdict`: options, exit codes and the files of a short decision."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from lirs_extensions.decide.command import read_duration
from lirs_wct.errors import ConfigError

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.parametrize("text", ["", "10", "-1s", "10 m", "nan s"])
def test_what_is_no_duration_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--budget must be a duration such as 90s, 10min or 2h"):
        read_duration(text, "--budget")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("simple", "--budget", "ten"), "--budget must be a duration"),
        (("simple", "--seed", "1-3"), "--seed is the first seed of the drives: one number, got 3"),
        (("simple", "--robot", "huksy"), "unknown robot 'huksy'"),
        (("nowhere.png",), "nowhere.png: no such file"),
    ],
)
def test_bad_input_is_one_line_and_code_2(
    arguments: tuple[str, ...], expected: str, wct: Any, tmp_path: Path
) -> None:
    code, _, message = wct("verdict", *arguments)
    assert (code, message.count("\n")) == (2, 1)
    assert expected in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_decision_drives_and_writes_its_page(wct: Any, tmp_path: Path) -> None:
    shutil.copy(EXAMPLES / "your_own_mapper.py", tmp_path / "my_slam.py")
    arguments = ("simple", "--mapper", "my_slam:DeadReckoning", "--seconds", "20", "--budget", "1h")
    code, out, err = wct("verdict", *arguments, "--gate")
    assert code == 4
    assert "verdict: DeadReckoning on husky does not work on simple: it worked in 0 of 3 drives" in out
    assert "0 of 3 worked: does not work" in err
    for name in ("verdict.html", "verdict.png", "verdict.json"):
        assert (tmp_path / "verdict" / name).stat().st_size > 0
