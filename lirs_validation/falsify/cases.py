"""Cases: parameters and their limits, words for a cause, and folders (docs/howto/falsify.md)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import yaml

from lirs_envs.generators.arena import ArenaConfig, arena
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.catalog import make_robot
from lirs_envs.sensing.sensors import SensorFaults, SensorNoise, write_noise
from lirs_validation.config import RunConfig
from lirs_validation.falsify import FalsifyOptions
from lirs_validation.sweep.suites import CASE, case_options, read_yaml_fields
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, unknown_name
from slam_baselines.mapper import short_name

Group = Literal["ground", "obstacles", "drive", "sensors"]
DIGITS = 3
"""Significant digits of a value."""
LEAST_RETURNS = 0.3
"""Smallest median share of beams with a return: without walls in sight no planar method can work."""


@dataclass(frozen=True)
class CaseParameter:
    """One parameter of the search.

    Attributes:
        name: unique; a field of `ArenaConfig`, `RunConfig`, `LidarNoise` or `SensorFaults`.
        group: parameters that are reset together first.
        default: value without difficulty.
        low: smallest plausible value.
        high: largest plausible value.
        unit: of the value, for tables.
        whole: whether the value is a whole number.
    """

    name: str
    group: Group
    default: float
    low: float
    high: float
    unit: str = ""
    whole: bool = False

    def clip(self, value: float) -> float:
        """Return the nearest legal value with few digits."""
        inside = min(max(value, self.low), self.high)
        if self.whole:
            return float(round(inside))
        return float(f"{inside:.{DIGITS}g}")

    def within(self, low: float, high: float) -> CaseParameter:
        """Return the parameter with other limits; its default is the nearest legal value."""
        return replace(self, low=low, high=high, default=min(max(self.default, low), high))


PARAMETERS: tuple[CaseParameter, ...] = (
    CaseParameter("relief", "ground", 0.0, 0.0, 2.0, "m"),
    CaseParameter("slope", "ground", 0.0, 0.0, 14.0, "deg"),
    CaseParameter("slope_direction", "ground", 90.0, 0.0, 90.0, "deg"),
    CaseParameter("roughness", "ground", 0.0, 0.0, 0.015, "m"),
    CaseParameter("obstacles", "obstacles", 20, 6, 60, whole=True),
    CaseParameter("obstacle_height", "obstacles", 2.0, 0.3, 2.0, "m"),
    CaseParameter("round_obstacles", "obstacles", 0.0, 0.0, 1.0),
    CaseParameter("symmetry", "obstacles", 0.0, 0.0, 1.0),
    CaseParameter("corridor", "obstacles", 0.0, 0.0, 26.0, "m"),
    CaseParameter("corridor_width", "obstacles", 3.0, 2.4, 6.0, "m"),
    CaseParameter("boundary", "obstacles", 1.0, 0.3, 1.0),
    CaseParameter("actors", "obstacles", 0, 0, 12, whole=True),
    CaseParameter("speed", "drive", 1.0, 0.4, 1.25),
    CaseParameter("turn_rate", "drive", 1.0, 0.5, 1.6),
    CaseParameter("reversing", "drive", 0.0, 0.0, 0.5),
    CaseParameter("stand", "drive", 0.0, 0.0, 10.0, "s"),
    CaseParameter("sigma", "sensors", 0.0, 0.0, 0.03, "m"),
    CaseParameter("dropout", "sensors", 0.0, 0.0, 0.3),
    CaseParameter("lag", "sensors", 0.0, 0.0, 0.12, "s"),
    CaseParameter("field_of_view", "sensors", 360.0, 120.0, 360.0, "deg"),
    CaseParameter("dust", "sensors", 0.0, 0.0, 0.1),
    CaseParameter("slip", "sensors", 0.0, 0.0, 0.3),
)
"""All parameters with their defaults and limits."""
OF_A_POLICY = ("ground", "obstacles")
"""Groups that matter to a policy; the environments have no faults of sensors."""


@dataclass(frozen=True)
class SearchLimits:
    """Parameters to search, and the plausibility of a case.

    Attributes:
        parameters: all parameters, with the limits in use.
        returns: smallest median share of beams with a return.
    """

    parameters: tuple[CaseParameter, ...] = PARAMETERS
    returns: float = LEAST_RETURNS

    def held(self, names: Iterable[str]) -> SearchLimits:
        """Return the limits with some parameters held at their defaults."""
        fixed = set(names)
        return replace(
            self,
            parameters=tuple(
                p.within(p.default, p.default) if p.name in fixed else p for p in self.parameters
            ),
        )

    def of_policy(self) -> SearchLimits:
        """Return the limits of a search for a policy's failures."""
        other = [p.name for p in self.parameters if p.group not in OF_A_POLICY or p.name == "actors"]
        return replace(self.held(other), returns=0.0)

    @property
    def free(self) -> tuple[CaseParameter, ...]:
        """Parameters whose limits leave a choice."""
        return tuple(p for p in self.parameters if p.low < p.high)

    def require_free(self) -> None:
        """Check that something is left to search.

        Raises:
            ConfigError: no parameter is free.
        """
        if not self.free:
            raise ConfigError("no parameter is left to search: the limits hold all at one value")

    @property
    def easiest(self) -> Case:
        """The case with all defaults."""
        return Case({p.name: float(p.default) for p in self.parameters})

    def case(self, position: FloatArray) -> Case:
        """Return the case at a position (n,) in the unit cube of the free parameters."""
        found = self.easiest
        for parameter, share in zip(self.free, position.tolist(), strict=True):
            value = parameter.low + share * (parameter.high - parameter.low)
            found = found.with_value(parameter.name, parameter.clip(value))
        return found

    def difference(self, case: Case) -> tuple[CaseParameter, ...]:
        """Return the parameters in which a case differs from the defaults."""
        return tuple(p for p in self.parameters if case.values[p.name] != p.default)


@dataclass(frozen=True)
class Case:
    """Values of all parameters.

    Attributes:
        values: value by name.
    """

    values: Mapping[str, float] = field(default_factory=dict)

    def with_value(self, name: str, value: float) -> Case:
        """Return the case with one other value."""
        return Case({**self.values, name: value})


def search_limits(options: FalsifyOptions) -> SearchLimits:
    """Return the limits of a search.

    Raises:
        ConfigError: the file of the limits cannot be used.
    """
    limits = SearchLimits() if options.limits is None else read_search_limits(Path(options.limits))
    return limits if options.policy is None else limits.of_policy()


def read_search_limits(path: Path) -> SearchLimits:
    """Read limits from a YAML file: `name: [low, high]`, `name: value`, and `returns`.

    Parameters that are left out keep their limits.

    Raises:
        SourceError: the file cannot be read; the message begins with its path.
        ConfigError: a name or value is not legal; the same.
    """
    entry = read_yaml_fields(path)
    names = {p.name: p for p in PARAMETERS}
    limits = SearchLimits()
    for name, given in entry.items():
        if name != "returns" and name not in names:
            raise ConfigError(f"{path}: {unknown_name('parameter', str(name), [*names, 'returns'])}")
        known = CaseParameter("returns", "sensors", 0.0, 0.0, 1.0) if name == "returns" else names[name]
        low, high = _interval(path, known, given)
        if name == "returns":
            limits = replace(limits, returns=low)
            continue
        changed = known.within(low, high)
        limits = replace(
            limits, parameters=tuple(changed if p.name == name else p for p in limits.parameters)
        )
    return limits


LEGAL: Mapping[str, tuple[float, float]] = {
    "relief": (0, 10), "slope": (0, 40), "slope_direction": (-360, 360), "roughness": (0, 0.3),
    "obstacles": (0, 300), "obstacle_height": (0, 10), "corridor": (0, 30), "corridor_width": (1, 20),
    "actors": (0, 50), "speed": (0.1, 2), "turn_rate": (0.1, 2), "stand": (0, 60), "sigma": (0, 1),
    "lag": (0, 1), "field_of_view": (10, 360),
}  # fmt: skip
"""Values that a limits file may give; of a share, 0 to 1."""


def _interval(path: Path, parameter: CaseParameter, given: object) -> tuple[float, float]:
    """Return the limits of one line of a file.

    Raises:
        ConfigError: they are not legal.
    """
    pair = given if isinstance(given, list) else [given, given]
    low, high = LEGAL.get(parameter.name, (0.0, 1.0))
    numbers = [v for v in pair if isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v)]
    if len(pair) != 2 or len(numbers) != 2 or not low <= numbers[0] <= numbers[1] <= high:
        raise ConfigError(
            f"{path}: {parameter.name} must be a number or [low, high] "
            f"within [{low:g}, {high:g}], got {given!r}"
        )
    return float(numbers[0]), float(numbers[1])


Values = Mapping[str, float]


def _slope(v: Values) -> str:
    across = abs(math.sin(math.radians(v["slope_direction"])))
    kind = "cross slope" if across > 0.87 else "slope" if across < 0.5 else "diagonal slope"
    return f"{v['slope']:.2g} deg {kind}"


PHRASES: Mapping[str, Callable[[Values], str]] = {
    "slope": _slope,
    "relief": lambda v: f"hills of {v['relief']:.2g} m",
    "roughness": lambda v: f"rough ground ({100 * v['roughness']:.2g} cm)",
    "corridor": lambda v: (
        f"two parallel walls {v['corridor']:.2g} m long and {v['corridor_width']:.2g} m apart"
    ),
    "obstacles": lambda v: f"{v['obstacles']:.0f} obstacles",
    "obstacle_height": lambda v: f"obstacles {v['obstacle_height']:.2g} m high",
    "round_obstacles": lambda v: f"{100 * v['round_obstacles']:.0f} % round obstacles",
    "symmetry": lambda v: f"obstacles in a regular grid ({100 * v['symmetry']:.0f} %)",
    "boundary": lambda v: f"an outer wall of which {100 * v['boundary']:.0f} % stands",
    "actors": lambda v: f"{v['actors']:.0f} walkers",
    "speed": lambda v: f"{v['speed']:.2g} times the usual speed",
    "turn_rate": lambda v: f"{v['turn_rate']:.2g} times the usual turn rate",
    "reversing": lambda v: f"driving backwards for {100 * v['reversing']:.0f} % of the time",
    "stand": lambda v: f"{v['stand']:.2g} s of standing at the start",
    "sigma": lambda v: f"range noise of {1000 * v['sigma']:.2g} mm",
    "dropout": lambda v: f"{100 * v['dropout']:.0f} % lost beams",
    "lag": lambda v: f"scans {1000 * v['lag']:.0f} ms late",
    "field_of_view": lambda v: f"a field of view of {v['field_of_view']:.0f} deg",
    "dust": lambda v: f"dust in {100 * v['dust']:.2g} % of the beams",
    "slip": lambda v: f"wheel slip of {100 * v['slip']:.0f} % of the slope",
}
"""Words for a changed parameter; directions and widths belong to another one."""


def cause(case: Case, limits: SearchLimits) -> str:
    """Return the changed parameters as words; empty if none is changed."""
    names = [p.name for p in limits.difference(case)]
    words = [PHRASES[name](case.values) for name in names if name in PHRASES]
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def sentence(options: FalsifyOptions, case: Case, limits: SearchLimits) -> str:
    """Return one sentence on the failure of a method."""
    who = f"{short_name(options.method)} on {options.robot}"
    found = cause(case, limits)
    fails = f"{who} fails with {found}" if found else f"{who} fails on the easiest ground already"
    reference = options.compared_with
    return f"{fails}; {short_name(reference)} does not." if reference else f"{fails}."


NOISE = "noise.yaml"
OF_RUN = ("actors", "speed", "turn_rate", "reversing", "stand")
"""Parameters that are options of a run."""
OF_FAULTS = ("lag", "field_of_view", "dust", "slip")
OF_ARENA = tuple(p.name for p in PARAMETERS if p.group in ("ground", "obstacles") and p.name not in OF_RUN)


def arena_options(case: Case, seed: int) -> dict[str, Any]:
    """Return the parameters of a case's arena as options of `ArenaConfig`."""
    found: dict[str, Any] = {name: case.values[name] for name in OF_ARENA}
    return found | {"obstacles": int(found["obstacles"]), "seed": seed}


def case_noise(case: Case, robot: str) -> SensorNoise:
    """Return the sensor noise of a case: the lidar's simulated noise and the case's degradation."""
    usual, v = SensorNoise().of_lidar(make_lidar_preset(make_robot(robot).lidar)), case.values
    lidar = replace(usual, sigma=usual.sigma + v["sigma"], dropout=v["dropout"])
    return SensorNoise(lidar=lidar, faults=SensorFaults(**{name: v[name] for name in OF_FAULTS}))


def write_case(
    folder: Path, case: Case, options: FalsifyOptions, *, method: str, seed: int, comment: str = ""
) -> RunConfig:
    """Write a case into a folder; return the run that `lirs-wct validate` reads from it.

    Args:
        folder: for the files.
        case: values of its parameters.
        options: of the search.
        method: mapper of the run.
        seed: of the drive and its sensors.
        comment: first line of the file with the run's options.

    Raises:
        OutputError: the folder cannot be written.
    """
    run: dict[str, Any] = {"robot": options.robot, "mapper": method, "seed": seed}
    run |= {"seconds": float(options.seconds)}
    run |= {p.name: _number(case, p.name) for p in PARAMETERS if p.name in OF_RUN and _is_set(case, p.name)}
    arena(folder.name, ArenaConfig(**arena_options(case, options.seed))).save(folder)
    if any(_is_set(case, p.name) for p in PARAMETERS if p.group == "sensors"):
        write_noise(folder / NOISE, case_noise(case, options.robot), "Sensor noise of this case.")
        run["noise"] = NOISE
    text = yaml.safe_dump({"run": run, "parameters": dict(case.values)}, sort_keys=False)
    (folder / CASE).write_text((f"# {comment}\n" if comment else "") + text, encoding="utf-8")
    return read_case(folder)


def read_case(folder: Path, changed: Mapping[str, Any] | None = None) -> RunConfig:
    """Return the run of a case's folder, with some options changed."""
    return RunConfig(source=str(folder), **(case_options(folder) | dict(changed or {})))


def _is_set(case: Case, name: str) -> bool:
    return case.values[name] != next(p.default for p in PARAMETERS if p.name == name)


def _number(case: Case, name: str) -> float:
    value = case.values[name]
    return int(value) if next(p.whole for p in PARAMETERS if p.name == name) else value


def require_cma() -> None:
    """Check that the package `cma` is installed.

    Raises:
        ConfigError: it is not.
    """
    try:
        import cma  # noqa: F401
    except ImportError:
        raise ConfigError(
            "the search needs the package cma: pip install 'lirs-wct[search]', or take --search random"
        ) from None
