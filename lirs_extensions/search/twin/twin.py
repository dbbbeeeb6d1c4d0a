"""Twin test of a log: comparison with its simulation, figures, and the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from lirs_envs.lidar.noise import LidarNoise, lidar_noise
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.sensing.sensors import SensorNoise, write_noise
from lirs_extensions.search.twin.fit import (
    FittedNoise,
    FittedOdometry,
    Sample,
    curve,
    fit_noise,
    fit_odometry,
    residual_distance,
)
from lirs_extensions.search.twin.replay import Replay, place_log, replay_figure, replay_log, replay_table
from lirs_extensions.search.twin.surface import (
    BLOCK,
    CLUSTER,
    GATE,
    LogComparison,
    compare,
    laser_poses,
    noisy_ranges,
    scan_arrays,
    simulate_scans,
)
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import MappedLog, run_mapping
from lirs_validation.logs.read_log import read_truth, truth_in_time
from lirs_validation.record.metric_catalog import NOTHING
from lirs_validation.report.page import PageFigure, PageSection, data_url, page_html, png
from lirs_validation.report.table import ReportTable
from lirs_wct import (
    BoolArray,
    FloatArray,
    IntArray,
    LaserScan,
    Pose2,
    Progress,
    SourceError,
    Trajectory,
    no_progress,
)
from lirs_wct.drawing.canvas import BLUE, GRAY, VERMILLION, Drawing, new_figure, plain_axes, title
from lirs_wct.files import atomic_folder, check_writable, write_json

LEAST_BLOCKS = 4
"""Fewest blocks of a log."""
MOST_SCANS = 1500
"""Most scans of a comparison; of longer logs every second, third, ... scan is used."""
LIMIT = 0.1
"""Largest residual that the picture shows, meters."""
NEGLIGIBLE = 1e-3
"""Share, meters or radians that are added before log and simulation are compared: less does not count."""
CAUSES = "loop closures that fail for another reason than noise, wheel slip, slopes"
"""Causes of errors that no simulation of a log has."""


def run_twin(
    config: MapConfig,
    *,
    lidar: str,
    seed: int,
    out: Path,
    replayed: Sequence[str] = (),
    draws: int = 20,
    jobs: int = 1,
    command: str = "",
    progress: Progress = no_progress,
) -> tuple[TwinResult, Path]:
    """Compare a log with its simulation, fit the noise, and write the result's folder.

    The folder holds twin.html, twin.json, noise.yaml, pictures, and the first of a replay's simulated logs.
    The log's truth is the config's relations or reference. The seed is that of noise and bootstrap.
    """
    make_lidar_preset(lidar)
    check_writable(out)
    mapped = run_mapping(replace(config, second="none"), progress=progress)
    if mapped.record.status != "ok":
        raise SourceError(f"{config.log}: {config.mapper} lost its place ({mapped.record.reason})")
    if not mapped.log.scans:
        raise SourceError(f"{config.log}: needs planar scans, got none")
    beams = [len(scan.ranges) for scan in mapped.log.scans]
    usual = np.flatnonzero(np.array(beams) == np.bincount(beams).argmax()).tolist()
    result = _compare_and_fit(config, mapped, usual, lidar, seed, progress)
    folder = out / f"{mapped.record.name}-twin"
    with atomic_folder(folder) as temporary:
        if replayed:
            path = place_log(mapped, usual, result.real)
            truth = truth_in_time(read_truth(config), mapped.log.lines)
            noises = [result.draw_noise(np.random.default_rng((seed, k))) for k in range(draws)]
            found = replay_log(config, truth, path, noises, replayed, temporary, jobs, progress)
            result = replace(result, replay=found)
        write_json(temporary / "twin.json", result.figures())
        write_noise(temporary / "noise.yaml", result.noise, f"fitted to {result.name}")
        write_page(temporary, result, command)
    return result, folder


def _compare_and_fit(
    config: MapConfig, mapped: MappedLog, usual: Sequence[int], lidar: str, seed: int, progress: Progress
) -> TwinResult:
    """Compare the log's scans with its map, and fit noise and odometry."""
    kept = usual[:: -(-len(usual) // MOST_SCANS)]
    scans = [mapped.log.scans[k] for k in kept]
    log = scan_arrays(scans, mapped.trajectory)
    if log.block.max() < LEAST_BLOCKS:
        raise SourceError(
            f"{config.log}: its path must be at least {LEAST_BLOCKS * BLOCK:g} m long for a comparison, "
            f"got {mapped.trajectory.length:.1f} m"
        )
    progress("compare", 0.1)
    real = compare(log)
    progress("fit", 0.3)
    try:
        fitted = fit_noise(real, log.poses, seed)
    except SourceError as error:
        raise SourceError(f"{config.log}: {error}") from error
    progress("fit", 0.8)
    odometry = [mapped.log.odometry[k] for k in kept]
    wheels = _fit_wheels(scans, odometry, real, fitted, seed)
    result = TwinResult(mapped.record.name, lidar, real, fitted, 1.0, wheels, len(mapped.log.scans))
    before = Sample.of(compare(simulate_scans(real, log.poses, result.sheet, seed)))
    distance = residual_distance(fitted.real, before)
    return replace(result, distance_before=distance, wheels=mapped.record.wheels)


def _fit_wheels(
    scans: Sequence[LaserScan],
    odometry: Sequence[Pose2 | None],
    real: LogComparison,
    fitted: FittedNoise,
    seed: int,
) -> FittedOdometry | None:
    """Return the errors of the scans' odometry; None if a scan has none."""
    known = [pose for pose in odometry if pose is not None]
    if len(known) < len(scans):
        return None
    stamps = np.array([scan.stamp for scan in scans])
    measured = laser_poses(Trajectory.from_poses(stamps, known), scans)
    length = SensorNoise().odometry.scale_length
    return fit_odometry(measured, real.scans.poses, stamps, fitted.poses, length, seed)


@dataclass(frozen=True)
class TwinResult:
    """Result of a twin test.

    Attributes:
        real: Comparison of the log's odd blocks with the map of its even blocks.
        distance_before: Kolmogorov distance of a simulation with the data sheet's noise.
        odometry: Errors of the odometry; None where the log has none, or is too short.
        total: Number of scans of the log.
        replay: Errors of mappers on the log and on its simulation; None = not requested.
        wheels: Scale errors of the odometry in words; empty where they are not known.
    """

    name: str
    lidar: str
    real: LogComparison
    fitted: FittedNoise
    distance_before: float
    odometry: FittedOdometry | None
    total: int
    replay: Replay | None = None
    wheels: str = ""

    @property
    def sheet(self) -> LidarNoise:
        """Noise of the lidar's data sheet, with the log's steps."""
        sheet = lidar_noise(make_lidar_preset(self.lidar), "datasheet")
        return replace(sheet, quantization=self.fitted.noise.quantization)

    @property
    def noise(self) -> SensorNoise:
        """Noise of all sensors; those that were not fitted have the defaults."""
        made = SensorNoise(lidar=self.fitted.noise)
        if self.odometry is None:
            return made
        sigma, constant = self.odometry.scale_sigma[0], self.odometry.scale
        wheels = replace(made.odometry, scale_sigma=sigma, scale_bias=constant)
        rates = {"rate_sigma": self.odometry.rate_sigma[0], "rate_bias": self.odometry.rate_bias}
        return replace(made, odometry=wheels, imu=replace(made.imu, **rates))

    def draw_noise(self, rng: np.random.Generator) -> SensorNoise:
        """Return the noise of a random bootstrap sample of the fit."""
        fitted, wheels = self.fitted, self.odometry
        fitted = replace(fitted, noise=fitted.samples[rng.integers(len(fitted.samples))])
        if wheels is not None:
            scale, rate = ((sigma,) * 3 for sigma in rng.choice(wheels.samples).tolist())
            wheels = replace(wheels, scale_sigma=scale, rate_sigma=rate)
        return replace(self, fitted=fitted, odometry=wheels).noise

    @property
    def sentences(self) -> tuple[str, ...]:
        """The result in a sentence each: noise, distributions, and the conclusion."""
        at = float(np.median(self.fitted.real.ranges))
        unmatched = 1 - float(self.real.used.sum() / (~self.real.scans.even).sum())
        ours, theirs = (1000 * (n.sigma + n.sigma_relative * at) for n in (self.fitted.noise, self.sheet))
        return (
            f"At {at:.1f} m this lidar's noise is {ours:.1f} mm, that of {self.lidar} {theirs:.1f} mm.",
            "The Kolmogorov distance between real and simulated residuals is "
            f"{self.fitted.distance:.2f} with noise.yaml and {self.distance_before:.2f} with {self.lidar}.",
            *filter(None, (self.wheels,)),
            *(self.replay.sentences if self.replay else ()),
            f"What differs most: {self._largest_difference()}.",
            f"Not covered: {CAUSES}, scans that do not match the map ({100 * unmatched:.0f} %), "
            "and what it lacks, such as people "
            f"({100 * _beam_shares(self.real)['on objects']:.1f} % of the beams).",
        )

    def _largest_difference(self) -> str:
        """Return the figure with the largest factor between log and simulation, in words."""
        samples = self.fitted.real, self.fitted.simulated
        lost, mixed = zip(*(sample.shares(sample.blocks).tolist() for sample in samples), strict=True)
        width = tuple(np.diff(np.quantile(s.residual, (0.1587, 0.8413))).item() / 2 for s in samples)
        rows = [("beams lost", 100.0, "%", lost), ("mixed pixels", 100.0, "%", mixed)]
        rows.append(("width of the residuals", 1000.0, "mm", width))
        if self.replay is not None and self.replay.odometry is not None:
            distance, turn = zip(*self.replay.odometry, strict=True)
            rows.append(("odometry's error of distance over 5 m", 100.0, "%", distance))
            rows.append(("odometry's error of turn over 5 m", math.degrees(1), "deg", turn))
        name, scale, unit, (real, simulated) = max(
            rows, key=lambda row: abs(math.log((row[3][0] + NEGLIGIBLE) / (row[3][1] + NEGLIGIBLE)))
        )
        return f"{name}, {scale * real:.1f} {unit} in the log and {scale * simulated:.1f} {unit} simulated"

    def figures(self) -> dict[str, Any]:
        """Return all figures, for JSON."""
        f, sample = self.fitted, self.fitted.real
        lost, mixed = sample.shares(sample.blocks).tolist()
        lost_simulated, mixed_simulated = f.simulated.shares(f.simulated.blocks).tolist()
        wide = sample.widths(sample.blocks)
        known = np.isfinite(wide) & np.isfinite(f.map_width)
        map_share = float(np.sum(f.map_width[known] ** 2) / np.sum(wide[known] ** 2))
        return {
            "log": self.name,
            "lidar": self.lidar,
            "sentences": list(self.sentences),
            "scans": {
                "log": self.total,
                "used": len(self.real.used),
                "odd blocks": int((~self.real.scans.even).sum()),
                "localized": int(self.real.used.sum()),
            },
            "beams": _beam_shares(self.real),
            "noise": {"fitted": asdict(f.noise), "low": asdict(f.low), "high": asdict(f.high)},
            "kolmogorov": {"before": self.distance_before, "after": f.distance},
            "lost": {"real": lost, "simulated": lost_simulated},
            "mixed_pixels": {"real": mixed, "simulated": mixed_simulated},
            "map_width": [None if math.isnan(width) else width for width in f.map_width.tolist()],
            "map_share": map_share,
            "by_range": {"real": curve(sample), "simulated": curve(f.simulated)},
            "odometry": self.odometry and {k: v for k, v in vars(self.odometry).items() if k != "samples"},
            "replay": None if self.replay is None else self.replay.figures(),
        }


def _beam_shares(real: LogComparison) -> dict[str, float]:
    """Return shares of the odd blocks' beams.

    They are compared, on objects that the map lacks, single and too near, or beyond its walls.
    """
    hits = np.isfinite(real.scans.ranges) & real.used[:, None]
    compared = real.compared & np.isfinite(real.residual)
    near = compared & (real.residual < -GATE)
    total = max(int(compared.sum()), 1)
    return {
        "compared": int(compared.sum()) / max(int(hits.sum()), 1),
        "on objects": int(_clusters(near).sum()) / total,
        "too near alone": int((near & ~_clusters(near)).sum()) / total,
        "beyond walls": int((compared & (real.residual > GATE)).sum()) / total,
    }


def _clusters(found: BoolArray) -> BoolArray:
    """Return (n, beams) members of runs of at least `CLUSTER` neighboring beams."""
    begins = np.ones_like(found[:, : 1 - CLUSTER])
    for k in range(CLUSTER):
        begins &= found[:, k : found.shape[1] - CLUSTER + 1 + k]
    members = np.zeros_like(found)
    for k in range(CLUSTER):
        members[:, k : found.shape[1] - CLUSTER + 1 + k] |= begins
    return members


def write_page(folder: Path, result: TwinResult, command: str) -> None:
    """Write `twin.html` and its pictures."""
    pictures = {"scans": scans_figure(result), "residuals": residual_figure(result.fitted)}
    if result.replay is not None:
        pictures["replay"] = replay_figure(result.replay)
    drawn = {name: png(drawing) for name, drawing in pictures.items()}
    for name, picture in drawn.items():
        (folder / f"{name}.png").write_bytes(picture)
    figures = {
        name: PageFigure(data_url(picture), name, width="60%" if name == "replay" else "100%")
        for name, picture in drawn.items()
    }
    tables = [make(result) for make in (scans_table, residuals_table, odometry_table)]
    tables.append(replay_table(result.replay))
    sections = [
        PageSection(t.key, t.title, tables=(t,), figures=(figures[t.key],) if t.key in figures else ())
        for t in tables
    ]
    command_section = PageSection("command", "Command", commands=(command,))
    html = page_html(f"Twin test: {result.name}", result.sentences, [*sections, command_section])
    (folder / "twin.html").write_text(html, encoding="utf-8")


def ranked_scans(result: TwinResult) -> tuple[IntArray, FloatArray]:
    """Return the compared scans from best to worst, and their mean absolute residuals, meters.

    A residual counts at most `GATE`, so that one object does not decide.
    """
    real = result.real
    known = real.compared & np.isfinite(real.residual)
    misfit = np.where(known, np.minimum(np.abs(np.nan_to_num(real.residual, posinf=GATE)), GATE), 0.0)
    count = known.sum(axis=1)
    rows = np.flatnonzero(count >= known.shape[1] / 10)
    means = misfit[rows].sum(axis=1) / count[rows]
    order = np.argsort(means, kind="stable")
    return rows[order], means[order]


def scans_figure(result: TwinResult) -> Drawing:
    """Draw real scan, simulated scan and difference at the best, median and worst pose."""
    scans, noise, beams = result.real.scans, result.fitted.noise, result.real.beams
    rows, means = ranked_scans(result)
    figure = new_figure(10.0, 9.0)
    axes = figure.subplots(3, 3, width_ratios=(1, 1, 1.2))
    for line, (name, at) in enumerate((("best", 0), ("median", len(rows) // 2), ("worst", len(rows) - 1))):
        k = int(rows[at])
        simulated = noisy_ranges(beams.ranges[k : k + 1], scans.range_max, noise, k)[0]
        reach = float(np.quantile(scans.ranges[k][np.isfinite(scans.ranges[k])], 0.98)) * 1.1
        real, simulation, difference = axes[line]
        for ax, ranges, color, what in (
            (real, scans.ranges[k], BLUE, "real scan"),
            (simulation, simulated, VERMILLION, "simulated"),
        ):
            for shown, size, shade in ((beams.ranges[k], 6, GRAY), (ranges, 3, color)):
                known = np.isfinite(shown)
                x = shown[known] * np.cos(scans.angles[known])
                y = shown[known] * np.sin(scans.angles[known])
                # Forward is up.
                ax.plot(-y, x, ".", color=shade, markersize=size)
            ax.plot(0, 0, "^", color="black", markersize=5)
            ax.set_xlim(-reach, reach)
            ax.set_ylim(-reach / 4, reach)
            ax.set_aspect("equal")
            plain_axes(ax, "m", "m")
            title(ax, f"{name}: {what}" if ax is real else what)
        _difference(difference, result, k, simulated.astype(np.float64))
        title(difference, f"difference, mean {1000 * means[at]:.0f} mm")
    return figure


def _difference(ax: Axes, result: TwinResult, k: int, simulated: FloatArray) -> None:
    """Draw measured less expected range of one scan's beams, real and simulated, millimeters."""
    angles = np.degrees(result.real.scans.angles)
    compared = result.real.compared[k]
    expected = np.where(compared, result.real.beams.ranges[k], np.nan)
    for ranges, color in ((simulated, VERMILLION), (result.real.scans.ranges[k], BLUE)):
        shown = 1000 * np.clip(ranges - expected, -GATE, GATE)
        ax.plot(angles[compared], shown[compared], ".", color=color, markersize=4)
    plain_axes(ax, "beam, deg", "measured less expected, mm")


def residual_figure(fitted: FittedNoise) -> Drawing:
    """Draw the residuals' width over the range, and their distributions."""
    figure = new_figure(9.0, 3.6)
    width, distribution = figure.subplots(1, 2)
    both = (("log", fitted.real, BLUE), ("simulated with noise.yaml", fitted.simulated, VERMILLION))
    bins = np.linspace(-LIMIT, LIMIT, 101)
    for name, sample, color in both:
        rows = curve(sample)
        ranges = [row["range"] for row in rows]
        width.plot(ranges, [1000 * row["width"] for row in rows], "o-", color=color, label=name)
        width.plot(ranges, [1000 * row["bias"] for row in rows], "o:", color=color, markersize=3)
        distribution.hist(
            sample.residual, bins=bins.tolist(), density=True, histtype="step", color=color, label=name
        )
    width.set_ylim(bottom=min(0.0, width.get_ylim()[0]))
    plain_axes(width, "expected range, m", "residuals, mm")
    plain_axes(distribution, "measured less expected range, m", "density, 1/m")
    title(width, "Half the central 68 % (solid), median (dotted)")
    title(distribution, f"Distance of the distributions: {fitted.distance:.3f}")
    width.legend(frameon=False, fontsize=8)
    return figure


def scans_table(result: TwinResult) -> ReportTable:
    """Return the counts of scans and shares of beams."""
    figures = result.figures()
    rows = [(f"scans {name}", str(count)) for name, count in figures["scans"].items()]
    rows += [(f"beams {name}", f"{100 * share:.1f} %") for name, share in figures["beams"].items()]
    caption = (
        "Scans of odd blocks in the map of the even ones: gray the map, blue the log, red its simulation. "
        "Beams on objects meet something that the map lacks, such as people."
    )
    return ReportTable("scans", "Best, median and worst scan", caption, ("figure", "value"), tuple(rows))


def residuals_table(result: TwinResult) -> ReportTable:
    """Return residuals and fitted noise."""
    f, sheet = result.fitted, result.sheet
    names = (
        ("sigma", "noise, mm", 1000),
        ("sigma_relative", "noise per meter, mm/m", 1000),
        ("dropout", "beams lost, %", 100),
        ("mixed_pixels", "mixed pixels at edges, %", 100),
    )
    rows = tuple(
        (
            text,
            f"{scale * getattr(f.noise, name):.2f}",
            f"{scale * getattr(f.low, name):.2f} to {scale * getattr(f.high, name):.2f}",
            f"{scale * getattr(sheet, name):.2f}",
        )
        for name, text, scale in names
    )
    caption = "Noise with which the simulated log has the residuals of the real one; intervals of 95 %."
    headings = ("noise", "fitted", "interval", f"data sheet of {result.lidar}")
    return ReportTable("residuals", "Residuals and noise", caption, headings, rows)


def odometry_table(result: TwinResult) -> ReportTable:
    """Return the fitted errors of the odometry."""
    wheels = result.odometry
    caption = "Errors of distance and turn rate against the matched path; intervals of 95 %."
    headings = ("error", "fitted", "interval")
    if wheels is None:
        return ReportTable(
            "odometry", "Odometry", "The log has no odometry, or is too short for it.", headings, ()
        )
    rows = [
        (text, f"{scale * values[0]:.2f}", f"{scale * values[1]:.2f} to {scale * values[2]:.2f}")
        for text, scale, values in (
            ("distance, %", 100, wheels.scale_sigma),
            ("turn rate, deg/s", math.degrees(1), wheels.rate_sigma),
        )
    ]
    rows.append(("mean turn rate, deg/s", f"{math.degrees(wheels.rate_bias):.3f}", NOTHING))
    rows.append(("mean distance, %", f"{100 * wheels.scale:.2f}", NOTHING))
    if result.replay is not None and result.replay.odometry is not None:
        scales = (("distance over 5 m, %", 100), ("turn over 5 m, deg", math.degrees(1)))
        for (name, scale), real, drawn in zip(scales, *result.replay.odometry, strict=True):
            rows.append((f"{name}: log, simulated", f"{scale * real:.2f}", f"{scale * drawn:.2f}"))
    return ReportTable("odometry", "Odometry", caption, headings, tuple(rows))
