"""Forecast: probability that a drive works, before any drive, and changes that may help."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import astuple, dataclass, fields, replace
from functools import cache, cached_property
from importlib.resources import files
from operator import attrgetter
from typing import Any

import cv2
import numpy as np

from lirs_envs.lidar.presets import LIDARS, RING_LIDARS, LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import Caster, MeshCaster, RayCaster
from lirs_envs.robots.robot import Robot, make_robot
from lirs_validation.analysis.compare import ORIGINAL
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import plan_tour
from lirs_validation.experiment.scenario import DRIVEN_SIDE, is_large
from lirs_validation.metrics.map import STEEP, count_hits
from lirs_validation.metrics.world_geometry import ENOUGH_WALLS, cast_beams, standing_on
from lirs_wct import FloatArray, Pose2, WctError, World, build_world
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS

TOURS = 3
"""Tours along which scans are cast, each from another start."""
SPACING = 0.5
"""Meters between scans of a tour."""
MAX_SCANS = 120
"""Largest number of scans of a tour."""
NEIGHBOR_GAP = 0.5
"""Largest gap between neighboring hits of one surface, meters."""
COLUMN_STEP, COLUMN_GAP = 10, 1.0
"""Columns of a ring lidar of which one is cast, and the largest gap between its neighboring hits, meters."""
MIN_SHARE = 0.01
"""Share of a scan's beams on walls below which it is taken for this."""
MIN_INFORMATION = 1e-4
"""Information per beam below which a scan tells nothing."""
NO_INFORMATION = math.log10(MIN_INFORMATION)
REVISIT_RADIUS, REVISIT_PATH = 1.0, 10.0
"""A tour revisits a place if it comes within this radius of it after this path, meters."""
SHORT_DRIVE, LONGER = 60.0, 3.0
"""Simulated seconds below which a longer drive is tried, and its factor."""
MAX_CLOUD_METHODS = 2
"""Largest number of methods that read clouds and are tried."""
MAX_STEEP, MAX_WINDOWS = 0.3, 3
"""Largest share of steep faces in a window that a robot drives, and windows that are looked at."""
MODELS = "forecast.json"
"""File of the models in this package; `python benchmarks/verdict_study.py fit` writes it."""
STUDIED = ("attitude", "driver", "odometry_noise", "actors", "scan_time")
"""Options that must have their defaults for a forecast."""
MAX_FEATURE = 3.0
"""Largest standardized feature, either side: beyond the studied worlds, a forecast gets no bolder."""


@dataclass(frozen=True, kw_only=True)
class SiteFeatures:
    """Features of a site: shares of a scan's beams, and quantiles over the scans.

    Attributes:
        walls: Median share of hits on walls.
        walls_low: 10th percentile of the share of hits on walls.
        ground: Median share of hits on ground, which looks like walls to a planar mapper.
        position_information: 10th percentile of the logarithm (base 10) of the least information in x and y
            (see `scan_information`).
        yaw_information: 10th percentile of the logarithm of the information in yaw.
        loops: Share of the path that revisits places.
        wall_scans: Share of the scans with a hit on a wall; the models do not use it.
    """

    walls: float
    walls_low: float
    ground: float
    position_information: float
    yaw_information: float
    loops: float
    wall_scans: float = math.nan

    @property
    def vector(self) -> FloatArray:
        """(6,) features in the order of FEATURES; the first two as logarithms."""
        shares = np.maximum((self.walls, self.walls_low), MIN_SHARE)
        return np.array((*np.log10(shares), *astuple(self)[2:-1]))


FEATURES = tuple(entry.name for entry in fields(SiteFeatures))[:-1]
"""Names of the models' features."""


class DriveSite:
    """Place that a config drives: its world, and features along tours."""

    def __init__(self, world: World, config: RunConfig) -> None:
        self.world, self.config, self._robot = world, config, make_robot(config.robot)
        self._features: dict[LidarPreset, SiteFeatures] = {}

    @cached_property
    def _tours(self) -> list[FloatArray]:
        seeds = range(self.config.seed, self.config.seed + TOURS)
        return [plan_tour(self.world, self._robot, replace(self.config, seed=seed)).path for seed in seeds]

    def features(self, config: RunConfig | None = None) -> SiteFeatures:
        """Cast scans of a config's lidar along the tours; return features."""
        config = config or self.config
        preset = make_lidar_preset(config.lidar or self._robot.lidar)
        preset = preset if config.mapper in ALL_CLOUD_MAPPERS else preset.planar
        if preset not in self._features:
            self._features[preset] = self._cast(preset)
        return self._features[preset]

    def _cast(self, preset: LidarPreset) -> SiteFeatures:
        world = self.world
        caster: Caster = MeshCaster(world.mesh) if world.overhangs else RayCaster(world.surface, world.walls)
        poses = [pose for tour in self._tours for pose in _poses(tour)]
        scans = [_look_around(world, self._robot, preset, caster, pose) for pose in poses]
        walls, ground = (count / preset.beams for count in count_hits(world, [hits for hits, _ in scans]))
        position, yaw = np.array([information for _, information in scans]).T
        return SiteFeatures(
            walls=float(np.median(walls)),
            walls_low=float(np.percentile(walls, 10)),
            ground=float(np.median(ground)),
            position_information=float(np.percentile(position, 10)),
            yaw_information=float(np.percentile(yaw, 10)),
            loops=float(np.mean([_loop_share(tour) for tour in self._tours])),
            wall_scans=float(np.mean(walls > 0)),
        )


def _poses(path: FloatArray) -> list[Pose2]:
    """Return poses along a path, SPACING meters apart, facing ahead."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    at = np.linspace(0.0, along[-1], min(MAX_SCANS, 2 + int(along[-1] / SPACING)))
    x, y = np.interp(at, along, path[:, 0]), np.interp(at, along, path[:, 1])
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    return [Pose2(*values) for values in np.column_stack((x, y, yaw)).tolist()]


def _look_around(
    world: World, robot: Robot, preset: LidarPreset, caster: Caster, pose: Pose2
) -> tuple[FloatArray, tuple[float, float]]:
    """Return a scan's hits (n, 2) in the world frame, and its two informations."""
    laser = standing_on(world, robot, pose) @ robot.T_base_laser
    points, hit = cast_beams(caster, preset, laser, preset.directions)
    met = points[hit][:, :2]
    if preset.rings == 1:
        return met + laser.position[:2], scan_information(met, preset.beams)
    columns = preset.all_directions.reshape(preset.rings, preset.beams, 3)[:, ::COLUMN_STEP]
    cloud, _ = cast_beams(caster, preset, laser, columns.reshape(-1, 3))
    return met + laser.position[:2], cloud_information(cloud.reshape(columns.shape))


def scan_information(points: FloatArray, beams: int) -> tuple[float, float]:
    """Return logarithms of a planar scan's information in position and yaw, per beam.

    Fisher information of scan matching with unit noise (Censi, ICRA 2007): the sum of J J^T over hits, with
    J = (n, p x n) of a hit p with the normal n. The position's is the smallest eigenvalue in x and y; the
    yaw's is its Schur complement, in square meters.

    Args:
        points: (n, 2) hits in the order of the beams, relative to the sensor, meters.
        beams: Beams in a scan.
    """
    along = np.diff(points, axis=0)
    length = np.hypot(*along.T)
    joined = (length > 0) & (length < NEIGHBOR_GAP)
    normals = np.column_stack((-along[joined, 1], along[joined, 0])) / length[joined, None]
    middle = (points[:-1][joined] + points[1:][joined]) / 2
    J = np.column_stack((normals, middle[:, 0] * normals[:, 1] - middle[:, 1] * normals[:, 0]))
    return _logarithms(J.T @ J / beams)


def cloud_information(cloud: FloatArray) -> tuple[float, float]:
    """Return logarithms of a cloud's information in position and yaw, per point.

    As for a planar scan, with normals in space: J = (n, p x n), with z, roll and pitch eliminated.

    Args:
        cloud: (rings, columns, 3) end points relative to the sensor, meters; NaN without a hit.
    """
    corner, aside, above = cloud[:-1, :-1], cloud[:-1, 1:] - cloud[:-1, :-1], cloud[1:, :-1] - cloud[:-1, :-1]
    normals = np.cross(aside, above)
    area = np.linalg.norm(normals, axis=2)
    with np.errstate(invalid="ignore"):
        joined = (
            (area > 0)
            & (np.linalg.norm(aside, axis=2) < COLUMN_GAP)
            & (np.linalg.norm(above, axis=2) < COLUMN_GAP)
        )
    n, p = normals[joined] / area[joined, None], (corner + (aside + above) / 2)[joined]
    turn = np.cross(p, n)
    kept, eliminated = np.column_stack((n[:, :2], turn[:, 2])), np.column_stack((n[:, 2], turn[:, :2]))
    across: Any = kept.T @ eliminated
    A = kept.T @ kept - across @ np.linalg.pinv(eliminated.T @ eliminated) @ across.T
    return _logarithms(A / area.size)


def _logarithms(A: Any) -> tuple[float, float]:
    """Return logarithms of the least information in x and y, and of that in yaw."""
    smallest = float(np.linalg.eigvalsh(A[:2, :2])[0])
    schur = float(A[2, 2] - A[2, :2] @ np.linalg.pinv(A[:2, :2]) @ A[:2, 2])
    return math.log10(max(smallest, MIN_INFORMATION)), math.log10(max(schur, MIN_INFORMATION))


def _loop_share(path: FloatArray) -> float:
    """Return the share of a path's points that revisit places."""
    steps = np.hypot(*np.diff(path, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    every = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], SPACING)))
    if not len(every):
        return 0.0
    points, at = path[every], along[every]
    near = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) < REVISIT_RADIUS
    earlier = at[None] < at[:, None] - REVISIT_PATH
    return float((near & earlier).any(axis=1).mean())


@dataclass(frozen=True)
class LogisticModel:
    """Logistic regression of the share of drives that work on standardized features.

    Attributes:
        mean: (k,) means of the features.
        scale: (k,) standard deviations; 1 where a feature is constant.
        weights: (k + 1,) weights of the standardized features, the last one of the constant.
    """

    mean: FloatArray
    scale: FloatArray
    weights: FloatArray

    def standardize(self, features: FloatArray) -> FloatArray:
        """Return features (n, k) in standard deviations from the mean, at most MAX_FEATURE."""
        return np.clip((features - self.mean) / self.scale, -MAX_FEATURE, MAX_FEATURE)

    def probability(self, features: FloatArray) -> FloatArray:
        """Return (n,) probabilities of success of features (n, k)."""
        logit: FloatArray = self.standardize(features) @ self.weights[:-1] + self.weights[-1]
        return 1 / (1 + np.exp(-logit))

    def to_dict(self) -> dict[str, Any]:
        """Return the model as JSON stores it."""
        return {name: [float(f"{v:.4g}") for v in values] for name, values in vars(self).items()}


@cache
def _models() -> dict[str, LogisticModel]:
    """Return the stored models by method."""
    stored = json.loads(files(__package__).joinpath(MODELS).read_text(encoding="utf-8"))
    if tuple(stored["features"]) != FEATURES:
        raise ValueError(f"{MODELS} was fitted to other features: fit it again")
    return {
        method: LogisticModel(**{name: np.array(values) for name, values in model.items()})
        for method, model in stored["methods"].items()
    }


def forecast(features: SiteFeatures, config: RunConfig) -> float | None:
    """Return the probability that a drive works; None for what was not studied.

    The study drove tours of 60 s with the default sensors; docs/measured.md has its calibration.
    """
    default = RunConfig(source=config.source)
    studied = all(getattr(config, name) == getattr(default, name) for name in STUDIED)
    if config.mapper not in _models() or not studied:
        return None
    return float(_models()[config.mapper].probability(features.vector[None])[0])


def changes(site: DriveSite, *, short: bool) -> dict[str, RunConfig]:
    """Return labels and configs of changes that may help, the most promising first.

    After drives that are too `short`, only longer ones do.
    """
    config, features = site.config, site.features()
    longer = replace(config, seconds=LONGER * config.seconds)
    drive = {f"{longer.seconds:g} s": longer} if short or config.seconds < SHORT_DRIVE else {}
    if short:
        return drive
    lidar = {name: other for name, other in _longer_lidar(config).items() if _sees_more(site, other)}
    clouds = {name: other for name, other in _clouds(config).items() if _sees_more(site, other)}
    if config.mapper not in MAPPERS or features.walls >= ENOUGH_WALLS:
        return {**_attitude(config), **drive, **lidar, **clouds}
    return {**clouds, **lidar, **_walled_window(site), **(_attitude(config) if features.wall_scans else {})}


def _sees_more(site: DriveSite, config: RunConfig) -> bool:
    """Whether a planar lidar meets more walls, or clouds tell the position."""
    if config.mapper in ALL_CLOUD_MAPPERS:
        return site.features(config).position_information > NO_INFORMATION
    return site.features(config).walls > site.features().walls


def _attitude(config: RunConfig) -> dict[str, RunConfig]:
    """Return the run of a planar method with the IMU's attitude."""
    aware = config.mapper.removesuffix(ORIGINAL)
    if aware != config.mapper and config.mapper in MAPPERS:
        aware = aware if aware in MAPPERS else "hector"
        return {f"terrain-aware {aware}": replace(config, mapper=aware, attitude="imu", parameters="")}
    blind = config.mapper in MAPPERS and config.attitude == "none"
    return {"with IMU attitude": replace(config, attitude="imu")} if blind else {}


def _longer_lidar(config: RunConfig) -> dict[str, RunConfig]:
    """Return the run with the next longer lidar, planar or with rings as its own."""
    own = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    longer = [p for p in LIDARS.values() if p.range_max > own.range_max and (p.rings > 1) == (own.rings > 1)]
    if not longer:
        return {}
    chosen = min(longer, key=attrgetter("range_max"))
    return {f"lidar {chosen.name} ({chosen.range_max:g} m)": replace(config, lidar=chosen.name)}


def _walled_window(site: DriveSite) -> dict[str, RunConfig]:
    """Return the run in a window of a large source that has walls."""
    config = site.config
    whole = build_world(config.source, replace(config.build, window=None))
    if not is_large(whole):
        return {}
    surface = whole.surface
    size = [max(2, round(DRIVEN_SIDE / cell)) for cell in surface.cell]
    steep = cv2.blur((surface.slope() > STEEP).astype(np.float32), size)
    shares = steep[size[1] // 2 :: size[1], size[0] // 2 :: size[0]]
    places = np.argwhere((shares > 0.0) & (shares <= MAX_STEEP)).tolist()
    for row, col in sorted(places, key=lambda place: -float(shares[*place]))[:MAX_WINDOWS]:
        x = surface.bounds[0] + (col + 0.5) * size[0] * surface.cell[0]
        y = surface.bounds[3] - (row + 0.5) * size[1] * surface.cell[1]
        build = replace(config.build, window=(round(x, 1), round(y, 1), DRIVEN_SIDE))
        with suppress(WctError):  # no place or way for the robot
            other = replace(config, build=build)
            features = DriveSite(build_world(config.source, build), other).features()
            if features.wall_scans > site.features().wall_scans:
                return {f"the window {x:g},{y:g},{DRIVEN_SIDE:g}": other}
    return {}


def _clouds(config: RunConfig) -> dict[str, RunConfig]:
    """Return the run with a lidar with rings and installed methods that read its clouds."""
    own = config.lidar or make_robot(config.robot).lidar
    lidar = own if own in RING_LIDARS else RING_LIDARS[0]
    names = [name for name, method in ALL_CLOUD_MAPPERS.items() if method.installed and name != config.mapper]
    return {
        f"{name} with lidar {lidar}": replace(config, mapper=name, parameters="", lidar=lidar, attitude="imu")
        for name in names[:MAX_CLOUD_METHODS]
    }
