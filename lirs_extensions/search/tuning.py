"""Search for parameters of a mapper: drives, comparison with the defaults on unseen seeds, files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

import numpy as np
import scipy  # its modules load on first use
import yaml

from lirs_extensions.search.case_search import (
    Case,
    SearchParameter,
    SearchSpace,
    TrialArchive,
    make_proposer,
    shrink,
    trial_key,
)
from lirs_extensions.search.options import TuneOptions
from lirs_validation.config import MapConfig, RunConfig
from lirs_validation.experiment.run import run_unwritten
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.logs.map_log import log_mapper, replay
from lirs_validation.logs.read_log import check_log, inertial_readings, read_log, read_truth, truth_in_time
from lirs_validation.metrics.mapped_log import scan_consistency, trajectory_accuracy
from lirs_validation.record.verdict import (
    AGREEING,
    LIMITS,
    VerdictFigures,
    classify,
    log_figures,
    run_figures,
)
from lirs_validation.report.table import ReportTable
from lirs_validation.sweep.engines import WorkerPool
from lirs_validation.sweep.tasks import read_yaml_fields
from lirs_wct import ConfigError, MapperError, SimulationError, Trajectory, require_known, unknown_name
from lirs_wct.files import staged_files, write_json
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.option import command_line
from slam_baselines.mapper import make_mapper, read_parameters

UNSEEN = 1000
"""Offset of the unseen seeds."""
STREAM = 43
"""Random stream of the search."""
KEPT_GAIN = 0.9
"""Share of the gain over the defaults that a simpler set of values must keep."""
Target = RunConfig | MapConfig
Report = Callable[[str], None]
MIN_RATIO, MAX_RATIO = 0.01, 100.0
"""Smallest and largest ratio of a path error and its limit; the latter also of a mapper that fails."""
_SCENARIOS = ScenarioCache()


def search_space(mapper: str, parameters: str, limits: Path | None) -> SearchSpace:
    """Return a mapper's parameters without those that the user sets."""
    require_known("mapper with parameters to tune", mapper, TUNABLE)
    defaults, fixed = default_parameters(mapper), read_parameters(parameters)
    free: dict[str, SearchParameter] = {}
    for t in TUNABLE[mapper]:
        if t.name not in fixed:
            default = defaults[t.name]
            whole = isinstance(default, int)
            free[t.name] = SearchParameter(t.name, mapper, default, t.low, t.high, whole=whole, log=t.log)
    space = SearchSpace(tuple(free.values()))
    if limits is not None:
        for name, pair in read_yaml_fields(limits).items():
            if name not in free:
                raise ConfigError(f"{limits}: {unknown_name('parameter', str(name), free)}")
            legal = free[name].low, free[name].high
            space = space.with_parameter(free[name].read_within(limits, pair, legal))
    space.require_free()
    return space


class TuneDrives:
    """Runs the drives of a tuning and keeps their scores."""

    def __init__(
        self,
        target: Target,
        options: TuneOptions,
        space: SearchSpace,
        out: Path,
        pool: WorkerPool | None = None,
    ) -> None:
        self.target, self.options, self.space = target, options, space
        self.defaults = default_parameters(target.mapper)
        self.archive = TrialArchive(out / "drives.jsonl", TuneScore, pool)

    def text(self, case: Case) -> str:
        """Return the held parameters and those of a case that differ from the mapper's defaults."""
        fixed = [self.target.parameters] if self.target.parameters else []
        values = [f"{n}={value:g}" for n, value in case.values.items() if value != self.defaults[n]]
        return ",".join([*fixed, *values])

    def run(self, cases: Sequence[Case], seeds: Sequence[int]) -> list[list[TuneScore]]:
        """Return the scores of cases by seed; of a log, by its parts."""
        target, trials = self.target, list[tuple[str, tuple[Any, ...]]]()
        for parameters, seed in itertools.product(map(self.text, cases), seeds):
            if isinstance(target, RunConfig):
                config = replace(target, parameters=parameters, seed=seed)
                trials.append((trial_key({"run": config.digest, "seed": seed}), (config,)))
                continue
            parts, path = 2 * self.options.unseen, Path(target.log)
            log = replace(target, parameters=parameters, seed=target.seed + seed)
            truth = [log.relations, log.reference, log.digest(path) if path.is_file() else log.log]
            key = trial_key({"log": [*truth, parameters, seed, parts]})
            trials.append((key, (log, seed, parts)))
        measure = measure_run if isinstance(target, RunConfig) else measure_part
        scores = self.archive.scores(measure, trials, target.mapper)
        return [scores[k : k + len(seeds)] for k in range(0, len(scores), len(seeds))]

    @property
    def seeds(self) -> tuple[list[int], list[int]]:
        """Seeds of the search and unseen ones; of a log, parts of its halves."""
        repeats, unseen = self.options.repeats, self.options.unseen
        if isinstance(self.target, RunConfig):
            first = self.target.seed
            return list(range(first, first + repeats)), list(range(first + UNSEEN, first + UNSEEN + unseen))
        known = np.unique(np.linspace(0, unseen - 1, repeats).round().astype(int))
        return known.tolist(), list(range(unseen, 2 * unseen))


def mean_loss(scores: Sequence[TuneScore]) -> float:
    """Return the mean loss of the drives that count; infinite if none does."""
    losses = [s.loss for s in scores if s.loss is not None]
    return fmean(losses) if losses else math.inf


def tune(drives: TuneDrives, report: Report = lambda line: None) -> Case:
    """Return the best set of values, reduced to the parameters that matter."""
    space, options, seeds = drives.space, drives.options, drives.seeds[0]
    (scores,) = drives.run([space.easiest], seeds)
    usual = best_loss = mean_loss(scores)
    if math.isinf(usual):
        source = drives.target.log if isinstance(drives.target, MapConfig) else drives.target.source
        raise ConfigError(f"{source}: no drive can be evaluated: {scores[0].reason}")
    best = space.easiest
    proposer = make_proposer(options.search, space, np.random.default_rng((drives.target.seed, STREAM)))
    while options.drives - drives.archive.count >= len(seeds):
        proposed = proposer.propose()[: (options.drives - drives.archive.count) // len(seeds)]
        before = drives.archive.count
        losses = [min(mean_loss(found), 10.0) for found in drives.run(proposed, seeds)]
        if min(losses) < best_loss:
            best_loss, best = min(losses), proposed[int(np.argmin(losses))]
        best_text = f"smallest score {math.exp(best_loss):.3f}, defaults {math.exp(usual):.3f}"
        report(f"{drives.archive.count} drives; {best_text}")
        proposer.learn(losses)
        if drives.archive.count == before:  # all cases of a small space are known
            break
    allowed = usual - KEPT_GAIN * (usual - best_loss)

    def good(case: Case) -> bool:
        return mean_loss(drives.run([case], seeds)[0]) <= allowed

    return best if best == space.easiest else shrink(best, space, good)[-1]


@dataclass(frozen=True)
class UnseenComparison:
    """Tuned values and defaults on the unseen seeds on which both count.

    Attributes:
        error: Median path error of the defaults and of the tuned values, meters.
        works: Number of seeds that work, of the defaults and of the tuned values.
        ratio: Geometric mean of tuned over default scores.
        low: Lower end of its 95 % interval (bootstrap of the paired differences).
    """

    pairs: int
    error: tuple[float, float]
    works: tuple[int, int]
    ratio: float
    low: float
    high: float

    @property
    def better(self) -> bool:
        """Whether the interval lies below 1."""
        return self.high < 1.0


def compare(drives: TuneDrives, tuned: Case) -> UnseenComparison:
    """Compare tuned values with the defaults on unseen seeds."""
    usual, found = drives.run([drives.space.easiest, tuned], drives.seeds[1])
    pairs = [(a, b) for a, b in zip(usual, found, strict=True) if a.loss is not None and b.loss is not None]
    if len(pairs) < 3:
        raise ConfigError(
            f"only {len(pairs)} of {len(usual)} unseen drives can be evaluated: {usual[0].reason}"
        )
    d = np.array([(b.loss or 0.0) - (a.loss or 0.0) for a, b in pairs])
    interval = (float(d[0]), float(d[0]))
    if np.ptp(d) > 0:
        made = scipy.stats.bootstrap((d,), np.mean, method="percentile", rng=np.random.default_rng(0))
        interval = (float(made.confidence_interval.low), float(made.confidence_interval.high))
    errors = [
        median(s.error if s.error is not None else math.inf for s in side)
        for side in zip(*pairs, strict=True)
    ]
    works = [sum(s.works for s in side) for side in zip(*pairs, strict=True)]
    ratio, low, high = (math.exp(x) for x in (float(d.mean()), *interval))
    return UnseenComparison(len(pairs), (errors[0], errors[1]), (works[0], works[1]), ratio, low, high)


def conclusion(drives: TuneDrives, tuned: Case, found: UnseenComparison) -> str:
    """Return one sentence on the result."""
    seeds = "seeds" if isinstance(drives.target, RunConfig) else "parts of the log"
    figures = (
        f"path error {found.error[1]:.3f} m instead of {found.error[0]:.3f} m (median of {found.pairs} "
        f"unseen {seeds}; works in {found.works[1]} instead of {found.works[0]}; "
        f"ratio of the scores {found.ratio:.2f}, 95 % interval {found.low:.2f} to {found.high:.2f})."
    )
    if found.better:
        values = ", ".join(drives.text(tuned).split(","))
        return f"{drives.target.mapper} with {values}: {figures}"
    if tuned == drives.space.easiest:
        return "No set was better than the defaults in the search."
    return f"No set was better than the defaults on unseen {seeds}. The best of the search has a {figures}"


def parameters_table(drives: TuneDrives, tuned: Case) -> ReportTable:
    """Return the changed ROS parameters, their defaults and tuned values."""
    names = ros_names(drives.target.mapper)
    rows = tuple(
        (names[p.name], f"{p.default:g}", f"{tuned.values[p.name]:g}") for p in drives.space.difference(tuned)
    )
    return ReportTable("parameters", "Parameters", "", ("ROS parameter", "default", "tuned"), rows)


def ros_text(drives: TuneDrives, tuned: Case) -> tuple[str, str]:
    """Return name and content of a YAML or Lua file for the node."""
    mapper = drives.target.mapper
    names = ros_names(mapper)
    values = {
        names[p.name]: int(v) if p.whole else float(v)
        for p in drives.space.difference(tuned)
        for v in [tuned.values[p.name]]
    }
    if mapper.startswith("cartographer"):
        return "tuned.lua", "".join(f"{name} = {value:g}\n" for name, value in values.items())
    method = mapper.removesuffix("_original")
    node = {"gmapping": "slam_gmapping", "hector": "hector_mapping"}.get(method, method)
    values = read_parameters(drives.target.parameters) | values
    return "tuned.yaml", yaml.safe_dump({node: {"ros__parameters": values}}, sort_keys=False)


def again(drives: TuneDrives, tuned: Case) -> str:
    """Return the command that runs the tuned values and the defaults again."""
    target, values = drives.target, drives.text(tuned)
    if isinstance(target, MapConfig):
        return command_line("map", target.log, target, mapper=target.mapper, parameters=values)
    both = f"{target.parameters or 'none'};{values}"
    seeds = f"{drives.seeds[1][0]}-{drives.seeds[1][-1]}"
    options = {"mapper": target.mapper, "parameters": both, "seed": seeds}
    return command_line("validate", target.source, target, **options)


def write_results(out: Path, drives: TuneDrives, tuned: Case, found: UnseenComparison) -> tuple[Path, ...]:
    """Write `tune.json`, `tune.md` and, if the values are better, the file for the ROS node."""
    sentence = conclusion(drives, tuned, found)
    table = parameters_table(drives, tuned).as_markdown()
    texts = {"tune.md": f"{sentence}\n\n{table}\n\n    {again(drives, tuned)}\n"}
    if found.better:
        name, text = ros_text(drives, tuned)
        texts[name] = text
    entry = {"sentence": sentence, "better": found.better, "parameters": drives.text(tuned)}
    entry |= {"values": dict(tuned.values), "drives": drives.archive.count, "unseen": asdict(found)}
    with staged_files(out) as folder:
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        write_json(folder / "tune.json", entry)
        for old in ("tuned.yaml", "tuned.lua"):
            (out / old).unlink(missing_ok=True)
    return tuple(out / name for name in (*texts, "tune.json"))


@dataclass(frozen=True)
class TuneScore:
    """Score of one drive.

    Attributes:
        loss: Logarithm of the path error over its limit, more for an unusable map; None = not counted.
        error: Path error, meters; without truth the revisit residual.
        works: Whether the verdict is `works`; of a log without truth, whether the passes agree.
        reason: Cause why the drive does not count, or the mapper failed; empty if neither.
    """

    loss: float | None
    error: float | None = None
    works: bool = False
    reason: str = ""


def score_of(figures: VerdictFigures) -> TuneScore:
    """Return the score of a drive by the figures of its verdict.

    The limit of the path error is that of `loses its way`. A map beyond its limits adds to the loss, so that
    a path that follows the odometry, or a map full of false walls, does not win.
    """
    kind, reasons = classify(figures)
    error, odometry = figures.error, figures.odometry_error
    text = "; ".join(f"{r.figure} {r.value}" for r in reasons)
    if kind in ("not evaluated", "no reference"):
        return TuneScore(None, reason=text)
    if kind == "failed" or figures.status == "lost" or error is None:
        return TuneScore(math.log(MAX_RATIO), error, reason=text)
    limit = LIMITS.over_odometry + LIMITS.times_odometry * (odometry or 0.0)
    loss = math.log(min(max(error / limit, MIN_RATIO), MAX_RATIO))
    if figures.f1_aligned is not None:
        loss += math.log(max(1.0, (1.0 - figures.f1_aligned) / (1.0 - LIMITS.f1_aligned)))
    if figures.false_occupied is not None:
        allowed = (figures.reference_false_occupied or 0.0) + LIMITS.false_occupied
        loss += math.log(max(1.0, figures.false_occupied / allowed))
    return TuneScore(loss, error, kind == "works")


def measure_run(config: RunConfig) -> TuneScore:
    """Drive through a world; return the score."""
    try:
        record = run_unwritten(config, maps=True, scenarios=_SCENARIOS)
    except MapperError as error:
        return TuneScore(math.log(MAX_RATIO), reason=str(error))
    except SimulationError as error:  # nothing was driven
        return TuneScore(None, reason=str(error))
    return score_of(run_figures(asdict(record)))


@lru_cache(maxsize=1)
def _read(config: MapConfig) -> tuple[LaserLog, Any, Any]:
    """Return a log with the relations and the reference, stamps repaired."""
    log = read_log(config)
    return log, *truth_in_time(read_truth(config), log.lines)


def measure_part(config: MapConfig, part: int, parts: int) -> TuneScore:
    """Map one of the equal parts of a log; return the score."""
    plain = replace(config, parameters="", mapper=MapConfig.mapper, seed=MapConfig.seed)
    whole, relations, reference = _read(plain)
    first, end = (k * len(whole.scans) // parts for k in (part, part + 1))
    readings = inertial_readings(config, whole)[first:end]
    log = replace(whole, scans=whole.scans[first:end], odometry=whole.odometry[first:end])
    with log_mapper(config) as mapper:
        if mapper.reads_clouds:
            raise ConfigError(f"{config.mapper} reads point clouds: tune takes planar mappers")
        check_log(config, mapper, log)
        try:
            tracking, *_ = replay(config, mapper, log, readings, lambda *_: None)
            path = mapper.trajectory()
        except MapperError as error:
            return TuneScore(math.log(MAX_RATIO), reason=str(error))
    status = "lost" if tracking.reason() else "ok"
    if relations is None and reference is None:
        quality = scan_consistency(log.scans, readings, path)
        residual = None if quality is None else quality.revisit_residual
        if residual is None:
            return TuneScore(None, reason="a part sees no place twice, so give --relations or --reference")
        loss = math.log(MAX_RATIO if status == "lost" else max(residual / AGREEING, MIN_RATIO))
        return TuneScore(loss, residual, status == "ok" and residual <= AGREEING)
    pairs = zip(log.scans, log.odometry, strict=True)
    known = [(scan.stamp, pose) for scan, pose in pairs if pose is not None]
    odometry = Trajectory.from_poses([stamp for stamp, _ in known], [pose for _, pose in known])
    alone = trajectory_accuracy(odometry, odometry, relations, reference).metrics() if len(odometry) else {}
    entry = {
        "status": status,
        "accuracy": trajectory_accuracy(path, odometry, relations, reference).metrics(),
        "odometry": alone,
    }
    return score_of(log_figures(entry | {"log": {}, "trajectory": {}, "map": {}}))


class Tunable(NamedTuple):
    """One parameter that a search may change.

    Attributes:
        log: Whether equal steps multiply the value.
        ros: Name of the ROS parameter or path in Cartographer's Lua tables; empty = as `name`.
    """

    name: str
    low: float
    high: float
    log: bool = True
    ros: str = ""


_MOTION = tuple(Tunable(name, 0.01, 0.5) for name in ("srr", "srt", "str", "stt"))
_GMAPPING = (
    Tunable("linearUpdate", 0.1, 2.0),
    Tunable("angularUpdate", 0.1, 1.0),
    Tunable("resampleThreshold", 0.1, 1.0, log=False),
    *_MOTION,
)
_HECTOR = (
    Tunable("map_multi_res_levels", 1, 3, log=False),
    Tunable("map_update_distance_thresh", 0.05, 1.0),
    Tunable("map_update_angle_thresh", 0.05, 1.5),
)
_BUILDER, _GRAPH = "TRAJECTORY_BUILDER_2D", "POSE_GRAPH"
_MATCHER = f"{_BUILDER}.ceres_scan_matcher"
_INSERTER = f"{_BUILDER}.submaps.range_data_inserter.probability_grid_range_data_inserter"


def _lua(path: str, low: float, high: float, *, name: str = "", log: bool = True) -> Tunable:
    """Return a parameter of Cartographer, whose field is called as in Lua unless named."""
    return Tunable(name or path.rpartition(".")[2], low, high, log, path)


TUNABLE: Mapping[str, tuple[Tunable, ...]] = {
    "gmapping": (*_GMAPPING, Tunable("ogain", 0.1, 5.0)),
    "gmapping_original": (
        *_GMAPPING,
        Tunable("ogain", 0.5, 10.0),
        Tunable("sigma", 0.01, 0.2),
        Tunable("kernelSize", 1, 3, log=False),
        Tunable("lstep", 0.02, 0.2),
        Tunable("astep", 0.02, 0.2),
        Tunable("iterations", 2, 8, log=False),
        Tunable("lsigma", 0.02, 0.3),
        Tunable("maxUrange", 5.0, 80.0),
    ),
    "hector": _HECTOR,
    "hector_original": (
        *_HECTOR,
        Tunable("update_factor_free", 0.3, 0.49, log=False),
        Tunable("update_factor_occupied", 0.55, 0.95, log=False),
        Tunable("laser_min_dist", 0.1, 1.0),
        Tunable("laser_max_dist", 4.0, 30.0),
    ),
    "cartographer": (
        _lua(f"{_BUILDER}.submaps.num_range_data", 20, 200),
        _lua(f"{_BUILDER}.motion_filter.max_distance_meters", 0.05, 0.5),
        _lua(f"{_BUILDER}.motion_filter.max_angle_radians", 0.01, 0.5),
        _lua(f"{_GRAPH}.optimize_every_n_nodes", 10, 200),
    ),
    "cartographer_original": (
        _lua(f"{_BUILDER}.max_range", 5.0, 60.0),
        _lua(f"{_BUILDER}.voxel_filter_size", 0.01, 0.1),
        _lua(f"{_MATCHER}.translation_weight", 0.1, 100.0, name="ceres_translation_weight"),
        _lua(f"{_MATCHER}.rotation_weight", 0.1, 400.0, name="ceres_rotation_weight"),
        _lua(f"{_BUILDER}.motion_filter.max_distance_meters", 0.05, 0.5),
        _lua(f"{_BUILDER}.motion_filter.max_angle_radians", 0.005, 0.2),
        _lua(f"{_BUILDER}.submaps.num_range_data", 20, 200),
        _lua(f"{_INSERTER}.hit_probability", 0.51, 0.7, log=False),
        _lua(f"{_INSERTER}.miss_probability", 0.4, 0.49, log=False),
        _lua(f"{_GRAPH}.constraint_builder.min_score", 0.4, 0.8, log=False),
        _lua(f"{_GRAPH}.optimization_problem.odometry_translation_weight", 1e2, 1e6),
        _lua(f"{_GRAPH}.optimization_problem.odometry_rotation_weight", 1e2, 1e6),
    ),
    "slam_toolbox_original": (
        Tunable("minimum_travel_distance", 0.1, 1.0),
        Tunable("minimum_travel_heading", 0.1, 1.0),
        Tunable("scan_buffer_size", 3, 70),
        Tunable("link_scan_maximum_distance", 0.5, 5.0),
        Tunable("loop_search_maximum_distance", 1.0, 10.0),
        Tunable("loop_match_minimum_response_coarse", 0.15, 0.6, log=False),
        Tunable("loop_match_minimum_response_fine", 0.2, 0.7, log=False),
        Tunable("correlation_search_space_smear_deviation", 0.02, 0.1),
        Tunable("distance_variance_penalty", 0.1, 2.0),
    ),
}
"""Parameters by mapper."""


def ros_names(mapper: str) -> dict[str, str]:
    """Return the names of a mapper's parameters for the ROS node."""
    return {tunable.name: tunable.ros or tunable.name for tunable in TUNABLE[mapper]}


def default_parameters(mapper: str) -> dict[str, float]:
    """Return the default of each of a mapper's parameters by name."""
    config = make_mapper(mapper).config  # type: ignore[attr-defined]
    return {tunable.name: getattr(config, tunable.name) for tunable in TUNABLE[mapper]}
