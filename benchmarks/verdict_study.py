"""How often is the verdict's forecast right, and how often its sequential test?

    python benchmarks/verdict_study.py drive [--data FOLDER] [--minutes 60] [--drives 20] [--quick]
    python benchmarks/verdict_study.py features [--data FOLDER] [--quick]
    python benchmarks/verdict_study.py inside [--methods hector,gmapping,cartographer] [--drives 5]
    python benchmarks/verdict_study.py evaluate | fit | streams

`drive` adds classes of drives to `verdict_drives.csv`, a letter each, and goes on where the last call ended.
`features` writes the features of the worlds to `verdict_sites.csv`. `evaluate` reads both: Brier scores of
the forecast with one family of worlds left out at a time, a table of reliability, and error rates of the
sequential test on random streams (`streams` prints these alone) and on the stored drives. `fit` stores the
models that `lirs-wct verdict` uses. `inside` drives anew and prints which share of the errors lies in
the 95 % ellipses that methods claim, run by run.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.steps import DATA, arguments, print_rows
from lirs_envs.generators.floor_plan import floor_plan
from lirs_envs.generators.terrain import EDGE, NATURAL_TERRAINS, NODES, generate
from lirs_extensions.decide import forecast
from lirs_extensions.decide.decide import P0, P1, SequentialTest
from lirs_extensions.decide.forecast import FEATURES, DriveSite, LogisticModel, SiteFeatures
from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import Scenario, ScenarioCache, build_scenario
from lirs_validation.record.run_record import RunRecord
from lirs_wct import MapperError, WctError
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.files import atomic_write, write_json
from lirs_wct.geometry import HeightField
from lirs_wct.ground import Terrain
from lirs_wct.option import read_names
from lirs_wct.world import World

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples" / "data"
METHODS = ("hector", "hector_original", "gmapping_original", "genz-icp", "slam_toolbox_original")
RING_LIDAR = "vlp16"
SECONDS = 60.0
BLOCK = 4
"""Drives of a method in one world, at most, before the next world."""
PLANAR = "planar"
"""Lidar of a planar method in the table of worlds: the robot's own."""
CLASSES = ("works", "path only", "adds nothing", "loses its way", "not evaluated", "failed")
LETTERS = {name: name[0] for name in CLASSES}
"""Letter of each class in the table."""
Key = tuple[str, str, str]
Row = dict[str, Any]
Point = tuple[float, float]
"""Forecast and observed share."""
ROBOTS = ("husky", "jackal")
"""Robots of the worlds of a family, in turn."""


@dataclass(frozen=True)
class Site:
    """World of the study, its family and its robot."""

    family: str
    name: str
    robot: str
    make: Callable[[], World | Path]

    def scenario(self, config: RunConfig) -> Scenario:
        """Return the config's scenario in this world."""
        world = self.make()
        if isinstance(world, World):
            return Scenario(replace(config, source=self.name), world, None)
        return build_scenario(replace(config, source=str(world)))


def sites(data: Path) -> Iterator[Site]:
    """Yield the worlds: five generated families, real laser maps, real heights, the bundled worlds."""
    rocks = [name for name in NATURAL_TERRAINS if "rocks" in name]
    bare = [name for name in NATURAL_TERRAINS if "rocks" not in name]
    courses = ("slopes", "steps", "stones", "waves", "craters", "gaps")
    families: dict[str, list[tuple[str, Callable[[], World | Path]]]] = {
        "natural": [(f"{name} 11", partial(_natural, name, 11)) for name in bare],
        "rocks": [(f"{name} {seed}", partial(_natural, name, seed)) for name in rocks for seed in (21, 22)],
        "floor plans": [(f"floor plan {seed}", partial(_floor_plan, seed)) for seed in range(31, 36)],
        "mazes": [(f"maze {seed}", partial(_course, "mazes", level, seed)) for level, seed in MAZES],
        "courses": [(f"{kind} 51", partial(_course, kind, 0.3, 51)) for kind in courses],
        "maps": [(path, partial(Path, data, "maps", path)) for path in MAPS],
        "heights": [(path, partial(Path, data, "height", path)) for path in HEIGHTS],
        "bundled": [
            *((name, partial(Path, name)) for name in ("simple", "medium", "advanced")),
            *((name, partial(Path, EXAMPLES, name)) for name in ("office.yaml", "dunes.png")),
        ],
    }
    for family, worlds in families.items():
        for k, (name, make) in enumerate(worlds):
            yield Site(family, name, ROBOTS[k % len(ROBOTS)], make)


MAZES = ((0.2, 41), (0.6, 42), (1.0, 43))
"""Difficulties and seeds."""
MAPS = (
    "navigation2/depot.yaml",
    "turtlebot_apps/willow-2010-02-18-0.10.yaml",
    "mir_robot/maze.yaml",
    "turtlebot3/map.yaml",
    "f1tenth_racetracks/Spielberg_map.yaml",
)
HEIGHTS = (
    "PX4-SITL_gazebo-classic__terrain.png",
    "gazebo_terrain_generator__prayag_height_map.tif",
    "gz-common__dem_squared.tif",
    "hmstl__scene.png",
    "unitree_mujoco__height_field.png",
    "vrc_driving_heightmap.png",
)


def _natural(kind: str, seed: int) -> World:
    z = NATURAL_TERRAINS[kind](np.random.default_rng(seed)).astype(np.float32)
    cell = EDGE / (NODES - 1)
    return World(f"{kind} {seed}", Terrain(HeightField.centered(z - z.min(), (cell, cell))))


def _floor_plan(seed: int) -> World:
    return World(f"floor plan {seed}", floor_plan(np.random.default_rng(seed)))


def _course(kind: str, difficulty: float, seed: int) -> World:
    return replace(generate(kind, difficulty, np.random.default_rng(seed)).world(), spawn_poses=())


def configs(site: Site, method: str, seeds: Iterable[int]) -> Iterator[RunConfig]:
    """Yield the config of a method's drive with each seed."""
    lidar = RING_LIDAR if method == "genz-icp" else None
    config = RunConfig(
        source=site.name, robot=site.robot, mapper=method, lidar=lidar, seconds=SECONDS, scan_time="instant"
    )
    yield from (replace(config, seed=seed) for seed in seeds)


def drive(options: argparse.Namespace) -> None:
    """Drive until the time is over or every method has its drives everywhere."""
    end = time.monotonic() + 60 * options.minutes
    own = {key: classes for key, classes in options.tables.drives().items() if key[2] in options.methods}
    for last in range(BLOCK, options.drives + BLOCK, BLOCK):
        for site in chosen_sites(options):
            scenario, cache = None, ScenarioCache()
            try:
                for method in options.methods:
                    key = site.family, site.name, method
                    lacking = range(len(own.get(key, "")) + 1, min(last, options.drives) + 1)
                    for config in configs(site, method, lacking):
                        if time.monotonic() > end:
                            return
                        cache.put(scenario := scenario or site.scenario(config))
                        own[key] = own.get(key, "") + letter_of(config, scenario, cache)
                        options.tables.add_drives(own)
            except WctError as error:
                print(f"left out: {site.name}: {error}", flush=True)


def letter_of(config: RunConfig, scenario: Scenario, cache: ScenarioCache) -> str:
    """Return the letter of a drive's class."""
    try:
        return LETTERS[_ended(config, scenario, cache).verdict.kind]
    except MapperError:
        return LETTERS["failed"]


def _ended(config: RunConfig, scenario: Scenario, cache: ScenarioCache) -> RunRecord:
    built = scenario.config
    return run(replace(config, source=built.source, build=built.build), scenarios=cache).record


def inside_rows(options: argparse.Namespace) -> Iterator[Row]:
    """Yield the shares of errors in the claimed 95 % ellipses, by method and family."""
    shares: dict[tuple[str, str], list[float]] = {}
    for site in chosen_sites(options):
        scenario, cache = None, ScenarioCache()
        for method in options.methods:
            for config in configs(site, method, range(1, options.drives + 1)):
                cache.put(scenario := scenario or site.scenario(config))
                share = _ended(config, scenario, cache).trajectory["inside_95"]
                for family in (site.family, "all") if share is not None else ():
                    shares.setdefault((method, family), []).append(share)
    for (method, family), values in sorted(shares.items()):
        low, median, high = np.quantile(values, (0.1, 0.5, 0.9)).tolist()
        row: Row = {"method": method, "family": family, "runs": len(values), "mean": float(np.mean(values))}
        yield row | {"10 %": low, "median": median, "90 %": high}


def find_features(options: argparse.Namespace) -> None:
    """Write the features of every world for both lidars, with the processor seconds of each."""
    for site in chosen_sites(options):
        for method in ("hector", "genz-icp"):
            (config,) = configs(site, method, (1,))
            try:
                world = site.scenario(config).world
                start = time.process_time()
                found = DriveSite(world, config).features()
            except WctError as error:
                print(f"left out: {site.name}: {error}", flush=True)
                break
            seconds = time.process_time() - start
            print(f"{site.name} {config.lidar or PLANAR}: {seconds:.1f} s", flush=True)
            key = site.family, site.name, config.lidar or PLANAR
            options.tables.add_sites({key: [getattr(found, name) for name in FEATURES]})


def chosen_sites(options: argparse.Namespace) -> list[Site]:
    """Return the worlds of the study; of a quick one, six."""
    return list(sites(options.data))[:: 7 if options.quick else 1]


@dataclass(frozen=True)
class Tables:
    """Results of the study in `verdict_drives.csv` and `verdict_sites.csv`, which several calls may write."""

    folder: Path = HERE

    def drives(self) -> dict[Key, str]:
        """Return the classes of the drives of each family, world and method."""
        return {key: classes for key, (classes,) in _rows(self.folder / "verdict_drives.csv").items()}

    def sites(self) -> dict[Key, list[float]]:
        """Return the features of each family, world and lidar."""
        rows = _rows(self.folder / "verdict_sites.csv").items()
        return {key: list(map(float, values)) for key, values in rows}

    def add_drives(self, classes: dict[Key, str]) -> None:
        """Add or replace classes of drives."""
        rows = {key: [letters] for key, letters in (self.drives() | classes).items()}
        _write(self.folder / "verdict_drives.csv", ("family", "world", "method", "classes"), rows)

    def add_sites(self, features: dict[Key, list[float]]) -> None:
        """Add or replace features of worlds."""
        found = (self.sites() | features).items()
        rows = {key: [f"{value:.4g}" for value in values] for key, values in found}
        _write(self.folder / "verdict_sites.csv", ("family", "world", "lidar", *FEATURES), rows)


def _rows(path: Path) -> dict[Key, list[str]]:
    lines = path.read_text(encoding="utf-8").splitlines()[1:] if path.exists() else []
    return {(row[0], row[1], row[2]): row[3:] for row in csv.reader(lines)}


def _write(path: Path, headings: tuple[str, ...], rows: dict[Key, list[str]]) -> None:
    with atomic_write(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([headings, *([*key, *values] for key, values in rows.items())])


def fit(features: FloatArray, successes: FloatArray, drives: FloatArray) -> LogisticModel:
    """Fit by maximum likelihood, with a Gaussian prior of standard deviation 1 on the weights.

    A world counts as one observation, however often it was driven.
    """
    mean, scale = features.mean(axis=0), features.std(axis=0)
    start = LogisticModel(mean, np.where(scale > 0, scale, 1.0), np.zeros(features.shape[1] + 1))
    standard, share = start.standardize(features), successes / drives

    def loss(weights: FloatArray) -> float:
        logit = standard @ weights[:-1] + weights[-1]
        return float((np.logaddexp(0, logit) - share * logit).sum() + (weights[:-1] ** 2).sum() / 2)

    return replace(start, weights=minimize(loss, start.weights).x)


@dataclass(frozen=True)
class MethodData:
    """Worlds of one method (n,): features (n, k), median share of beams on walls (n, 1), evaluated drives."""

    families: NDArray[np.str_]
    features: FloatArray
    walls: FloatArray
    successes: FloatArray
    drives: FloatArray
    classes: tuple[str, ...]


def data_of(method: str, tables: Tables) -> MethodData:
    """Return the worlds in which a method has an evaluated drive."""
    sites, rows = tables.sites(), []
    lidar = RING_LIDAR if method == "genz-icp" else PLANAR
    for (family, world, name), classes in tables.drives().items():
        evaluated = classes.replace("n", "")
        if name == method and evaluated:
            site = SiteFeatures(**dict(zip(FEATURES, sites[family, world, lidar], strict=True)))
            rows.append((family, site.vector, (site.walls,), classes.count("w"), len(evaluated), classes))
    families, *numbers, letters = zip(*rows, strict=True)
    features, walls, successes, drives = (np.array(column, float) for column in numbers)
    return MethodData(np.array(families), features, walls, successes, drives, letters)


def left_out_predictions(data: MethodData) -> dict[str, FloatArray]:
    """Return (n,) predictions of each model, whose family was left out of the fit."""
    found = {name: np.empty(len(data.drives)) for name in ("forecast", "base rate", "walls alone")}
    for family in np.unique(data.families):
        held = data.families == family
        train = data.successes[~held], data.drives[~held]
        for name, features in (("forecast", data.features), ("walls alone", data.walls)):
            found[name][held] = fit(features[~held], *train).probability(features[held])
        found["base rate"][held] = (train[0] / train[1]).mean()
    return found


def fit_models(tables: Tables) -> dict[str, Any]:
    """Return the model of each method, fitted to all of its worlds, as JSON stores them."""
    data = {method: data_of(method, tables) for method in METHODS}
    fitted = {method: fit(d.features, d.successes, d.drives).to_dict() for method, d in data.items()}
    return {"features": list(FEATURES), "methods": fitted}


def brier(predicted: FloatArray, data: MethodData) -> FloatArray:
    """Return (n,) the mean squared error over the drives of each world."""
    share = data.successes / data.drives
    return share * (1 - predicted) ** 2 + (1 - share) * predicted**2


def score_rows(tables: Tables, rng: np.random.Generator) -> tuple[list[tuple[str, ...]], list[Point]]:
    """Return a row of scores per method, and the point of every world."""
    rows, points = [], list[Point]()
    for method in METHODS:
        data = data_of(method, tables)
        predictions = left_out_predictions(data)
        scores = {name: brier(predicted, data) for name, predicted in predictions.items()}
        points += zip(predictions["forecast"], data.successes / data.drives, strict=True)
        means = (f"{scores[name].mean():.3f}" for name in ("forecast", "base rate", "walls alone"))
        gains = (gain_text(scores[name] - scores["forecast"], rng) for name in ("base rate", "walls alone"))
        rows.append((method, str(len(data.drives)), f"{data.drives.sum():.0f}", *means, *gains))
    return rows, points


def evaluate(tables: Tables) -> None:
    """Print Brier scores, reliability, and error rates of the sequential test."""
    rng = np.random.default_rng(1)
    title = "Brier score, one family left out; gains over the others with their lower 90 % bound"
    headings = (
        "method",
        "worlds",
        "drives",
        "forecast",
        "base rate",
        "walls",
        "over base rate",
        "over walls",
    )
    rows, points = score_rows(tables, rng)
    print_rows((dict(zip(headings, row, strict=True)) for row in rows), title, width=130)
    print_rows(reliability(points), "Reliability")
    print_rows(stream_errors(rng), "10,000 random streams each", width=110)
    print_rows(stored_errors(tables, rng), "Stored drives")


def gain_text(gains: FloatArray, rng: np.random.Generator) -> str:
    """Return a mean gain with its lower 90 % bound by a bootstrap over worlds."""
    means = gains[rng.integers(len(gains), size=(4000, len(gains)))].mean(axis=1)
    return f"{gains.mean():+.3f} (above {np.quantile(means, 0.1):+.3f})"


def reliability(points: list[Point]) -> Iterator[Row]:
    """Yield the observed share by forecast, over methods and worlds."""
    forecast, share = np.array(points).T
    for low in np.arange(0.0, 1.0, 0.2):
        chosen = (forecast >= low) & (forecast < low + 0.2 + (low > 0.7))
        if chosen.any():
            row = {"forecast": f"{low:.1f} to {low + 0.2:.1f}", "worlds": int(chosen.sum())}
            yield row | {"mean": float(forecast[chosen].mean()), "observed": float(share[chosen].mean())}


def stream_errors(rng: np.random.Generator, streams: int = 10_000) -> Iterator[Row]:
    """Yield the error rates and lengths of the sequential test on random streams."""
    for share in (P0, P1):
        ends = [end_of(rng.random(1000) < share) for _ in range(streams)]
        accepted = sum(test.outcome == "accepted" for test in ends) / streams
        length = float(np.mean([test.successes + test.failures for test in ends]))
        covered = sum(test.interval[0] <= share <= test.interval[1] for test in ends) / streams
        row = {"share": share, "accepted": accepted, "rejected": 1 - accepted, "drives, mean": length}
        yield row | {"interval holds the share": covered}


def stored_errors(tables: Tables, rng: np.random.Generator, orders: int = 100) -> Iterator[Row]:
    """Yield decisions on the stored drives in random orders, by the share of all of them."""
    rows: dict[str, list[list[str | None]]] = {}
    for method in METHODS:
        data = data_of(method, tables)
        for share, letters in zip(data.successes / data.drives, data.classes, strict=True):
            key = "at least 0.9" if share >= P1 else "at most 0.65" if share <= P0 else "between"
            works = np.array([letter == "w" for letter in letters.replace("n", "")])
            ends = [end_of(rng.permutation(works)).outcome for _ in range(orders)]
            rows.setdefault(key, []).append([*ends])
    for key, worlds in rows.items():
        together = [end for ends in worlds for end in ends]
        kinds = {"accepted": "accepted", "rejected": "rejected", "undecided": None}
        shares = {name: together.count(kind) / len(together) for name, kind in kinds.items()}
        yield {"share of all drives": key, "worlds": len(worlds)} | shares


def end_of(stream: BoolArray) -> SequentialTest:
    """Return the state of the test at its decision, or at the end of the stream."""
    test = SequentialTest()
    for success in stream.tolist():
        if test.outcome is not None:
            break
        test = SequentialTest(test.successes + success, test.failures + (not success))
    return test


def main(words: Sequence[str] | None = None) -> None:
    """Drive or evaluate."""
    defaults: dict[str, Any] = {"action": "evaluate", "data": DATA, "minutes": 60.0, "drives": 20}
    defaults |= {"methods": ",".join(METHODS), "quick": False, "tables": HERE}
    options = arguments(__doc__, "action", words=words, **defaults)
    options.tables = Tables(options.tables)
    options.methods = read_names(options.methods, "--methods")
    actions = {"drive": drive, "features": find_features}
    if options.action in actions:
        actions[options.action](options)
    elif options.action == "evaluate":
        evaluate(options.tables)
    elif options.action == "inside":
        print_rows(inside_rows(options), width=110)
    elif options.action == "fit":
        write_json(Path(forecast.__file__).with_name(forecast.MODELS), fit_models(options.tables))
    else:
        print_rows(stream_errors(np.random.default_rng(1)), width=110)


if __name__ == "__main__":
    main()
