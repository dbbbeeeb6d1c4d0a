"""Tuning with planted scores: best value, resumption, same bytes, names and bad input."""

import math
from pathlib import Path

import pytest

from lirs_extensions.search import tuning
from lirs_extensions.search.case_search import Case
from lirs_extensions.search.options import TuneOptions
from lirs_extensions.search.tuning import (
    TUNABLE,
    TuneDrives,
    TuneScore,
    compare,
    conclusion,
    default_parameters,
    ros_text,
    score_of,
    search_space,
    tune,
)
from lirs_validation.config import MapConfig, RunConfig
from lirs_validation.record.verdict import VerdictFigures
from slam_baselines.mapper import make_mapper, parameter_text, read_parameters
from tests.command_line import run_command

BEST = 0.2


class Planted:
    """Drives whose error is smallest where linearUpdate is `BEST`; other parameters have no effect."""

    def __init__(self) -> None:
        self.calls, self.stop_after = 0, math.inf

    def __call__(self, config: RunConfig) -> TuneScore:
        if self.calls >= self.stop_after:
            raise KeyboardInterrupt
        self.calls += 1
        value = read_parameters(config.parameters).get("linearUpdate", 1.0)
        loss = abs(math.log(value / BEST)) + 0.01 * (config.seed % 3)
        return TuneScore(loss, 0.1 * math.exp(loss), works=loss < 0.5)


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> Planted:
    made = Planted()
    monkeypatch.setattr(tuning, "measure_run", made)
    return made


def drives(out: Path, number: int = 240) -> TuneDrives:
    out.mkdir(exist_ok=True)
    config = RunConfig(source="simple", mapper="gmapping_original", seed=1)
    return TuneDrives(config, TuneOptions(drives=number), search_space(config.mapper, "", None), out)


def test_the_planted_value_alone_is_found_and_is_better_on_unseen_seeds(
    tmp_path: Path, planted: Planted
) -> None:
    made = drives(tmp_path / "out")
    tuned = tune(made)
    assert {p.name for p in made.space.difference(tuned)} == {"linearUpdate"}
    assert 0.5 * BEST < tuned.values["linearUpdate"] < 2 * BEST
    found = compare(made, tuned)
    assert found.better
    assert found.works == (0, 10)
    assert conclusion(made, tuned, found).startswith("gmapping_original with linearUpdate=")
    assert ros_text(made, tuned)[1].startswith("slam_gmapping:\n  ros__parameters:\n    linearUpdate: ")


def test_the_file_for_slam_toolbox_is_read_back(tmp_path: Path) -> None:
    """Held parameters stand in it, too."""
    config = RunConfig(source="simple", mapper="slam_toolbox_original", parameters="do_loop_closing=false")
    space = search_space(config.mapper, config.parameters, None)
    tuned = Case(space.easiest.values | {"scan_buffer_size": 24.0, "minimum_travel_distance": 0.25})
    name, text = ros_text(TuneDrives(config, TuneOptions(), space, tmp_path), tuned)
    (tmp_path / name).write_text(text)
    held = {"do_loop_closing": False, "scan_buffer_size": 24, "minimum_travel_distance": 0.25}
    assert read_parameters(parameter_text(str(tmp_path / name))) == held


def test_an_interrupted_search_ends_with_the_same_bytes(tmp_path: Path, planted: Planted) -> None:
    tune(drives(tmp_path / "whole", 120))
    planted.calls, planted.stop_after = 0, 50
    with pytest.raises(KeyboardInterrupt):
        tune(drives(tmp_path / "cut", 120))
    planted.stop_after = math.inf
    tune(drives(tmp_path / "cut", 120))
    texts = [(tmp_path / name / "drives.jsonl").read_bytes() for name in ("whole", "cut")]
    assert texts[0] == texts[1]


def test_a_path_that_follows_the_odometry_or_a_map_of_false_walls_does_not_win() -> None:
    def loss(error: float, f1: float = 0.9, false: float = 0.0) -> float:
        figures = VerdictFigures(
            status="ok",
            error=error,
            odometry_error=0.4,
            robot_lengths=20.0,
            f1_aligned=f1,
            false_occupied=false,
        )
        found = score_of(figures).loss
        assert found is not None
        return found

    assert loss(0.1) < loss(0.4)
    assert loss(0.1) < loss(0.1, f1=0.5)
    assert loss(0.1) < loss(0.1, false=0.5)


@pytest.mark.parametrize("mapper", sorted(TUNABLE))
def test_parameters_are_fields_whose_defaults_lie_within_the_limits(mapper: str) -> None:
    usual = default_parameters(mapper)
    for tunable in TUNABLE[mapper]:
        assert tunable.low <= usual[tunable.name] <= tunable.high
        for value in (tunable.low, tunable.high):
            kind = type(usual[tunable.name])
            make_mapper(mapper, **{tunable.name: kind(value)})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("simple", "--mapper", "wheel_lio", "--lidar", "vlp16"), "mapper with parameters to tune"),
        (("simple", "--mapper", "hector,gmapping"), "tune takes one robot, mapper, seed, ..., got 2"),
        (("simple", "--limits", "w.yaml"), "w.yaml: unknown parameter 'slope'"),
        (("simple", "--reference", "a.tum"), "simple: --relations and --reference are for logs"),
        (("simple", "--robot", "huskie"), "did you mean husky"),
        (("nowhere.png",), "nowhere.png"),
        (("simple", "--unseen", "1"), "unseen must be within [3, 1000], got 1"),
    ],
)
def test_bad_input_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("w.yaml").write_text("slope: 3\n")
    assert run_command("tune", *arguments, "-o", "out") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not Path("out").exists()


def test_the_printed_command_of_a_log_names_its_truth_and_seed(tmp_path: Path) -> None:
    log = MapConfig(log="hall.clf", mapper="gmapping_original", reference="truth.tum", seed=4)
    made = TuneDrives(log, TuneOptions(), search_space(log.mapper, "", None), tmp_path)
    tuned = made.space.easiest.with_value("linearUpdate", 0.3)
    command = tuning.again(made, tuned)
    assert command.startswith("lirs-wct map hall.clf ")
    for words in (
        "--reference truth.tum",
        "--seed 4",
        "--mapper gmapping_original",
        "--parameters linearUpdate=0.3",
    ):
        assert words in command


def test_a_log_whose_parts_see_no_place_twice_needs_a_reference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = Path(__file__).parents[3] / "examples" / "data" / "office.clf.gz"
    assert run_command("tune", str(log), "--mapper", "hector_original", "-o", str(tmp_path)) == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        f"lirs-wct: {log}: no drive can be evaluated: a part sees no place twice, "
        "so give --relations or --reference"
    )
