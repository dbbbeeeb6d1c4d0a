"""Ray runs every experiment at least once, and its result is there once, whatever happens to the workers."""

import warnings
from pathlib import Path

import pytest

from lirs_validation.config import EngineOptions
from lirs_validation.sweep.engines import perform_remotely, ray_session
from lirs_validation.sweep.sweep import Sweep
from lirs_validation.sweep.tasks import make_executor
from lirs_wct.errors import ConfigError
from tests.lirs_validation.sweep.fake_experiments import FakeExperiment

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_a_cluster_of_two_workers_survives_the_death_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'lirs-wct[dist]'")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'envs'}")
    (tmp_path / "notes").mkdir()
    manners = ["good", "dies once", "good", "good", "raises", "good", "no room once", "good"]
    experiments = [
        FakeExperiment(f"{k}", str(tmp_path / "notes"), manner, 0.3)  # type: ignore[arg-type]
        for k, manner in enumerate(manners)
    ]
    sweep = Sweep(experiments, tmp_path / "out")
    outcomes = list(sweep.run(make_executor(EngineOptions(address="local", jobs=2))))

    assert sorted(outcome.task for outcome in outcomes) == [experiment.name for experiment in experiments]
    assert [sweep.outcomes[experiment.name].status for experiment in experiments] == ["ok"] * 4 + [
        "error"
    ] + ["ok"] * 3
    assert [len(experiment.runs) for experiment in experiments] == [1, 2, 1, 1, 1, 1, 2, 1]
    killed, replacement = experiments[1].runs
    assert killed != replacement
    assert len({pid for experiment in experiments for pid in experiment.runs}) >= 3
    folders = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert folders == [*(experiment.name for experiment in experiments), "sweep.json"]
    assert (tmp_path / "out" / "0" / "result").read_text() == "0 True"


@pytest.mark.slow
def test_a_machine_that_is_lost_costs_one_line_and_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Ray printed 20 lines of the dead machine's state twice or more."""
    cluster_utils = pytest.importorskip("ray.cluster_utils", reason="Ray is not installed")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'envs'}")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.delenv("RAY_AUTH_MODE", raising=False)
    cluster = cluster_utils.Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    try:
        (tmp_path / "notes").mkdir()
        experiments = [FakeExperiment(f"{k}", str(tmp_path / "notes"), "good", 3.0) for k in range(8)]
        sweep = Sweep(experiments, tmp_path / "out")
        engine = make_executor(EngineOptions(address=cluster.address))
        # Connect while there is one node: a driver attached to the node that dies loses all it owns.
        with ray_session(cluster.address), warnings.catch_warnings(record=True) as warned:
            second = cluster.add_node(num_cpus=1)
            capfd.readouterr()
            for done, _ in enumerate(sweep.run(engine)):
                if done == 0:
                    cluster.remove_node(second, allow_graceful=False)
    finally:
        cluster.shutdown()
    assert [(o.status, o.reason) for o in sweep.outcomes.values()] == [("ok", "")] * 8
    assert {len(experiment.runs) for experiment in experiments} <= {1, 2}
    assert "".join(capfd.readouterr()) == ""
    assert [str(entry.message) for entry in warned] == [
        "1 of 2 machines of the cluster were lost; others did their runs"
    ]


@pytest.mark.slow
def test_where_no_cluster_answers_it_is_said(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'lirs-wct[dist]'")
    (tmp_path / "notes").mkdir()
    sweep = Sweep([FakeExperiment("a", str(tmp_path / "notes"))], tmp_path / "out")
    with pytest.raises(ConfigError, match=r"--address 127\.0\.0\.1:1: no Ray cluster answers there"):
        list(sweep.run(make_executor(EngineOptions(address="127.0.0.1:1"))))


@pytest.mark.parametrize("seconds", [None, pytest.param(60.0, marks=pytest.mark.slow)])
def test_an_experiment_that_makes_its_world_itself_needs_none(tmp_path: Path, seconds: float | None) -> None:
    (tmp_path / "notes").mkdir()
    experiment = FakeExperiment("alone", str(tmp_path / "notes"))
    outcome, files = perform_remotely(experiment, None, seconds, str(ROOT))
    assert outcome.status == "ok"
    assert files["result"] == b"alone True"
    assert set(files) == {"result", "manifest-sha256.txt"}
