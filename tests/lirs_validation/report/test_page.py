"""The report: one page that needs nothing else, failures first, every number one of the records'."""

import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.analysis.compare import repeats
from lirs_validation.analysis.results import RunFolder, read_results
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.metric_catalog import metrics_named
from lirs_validation.record.run_record import RunGroup, by_group
from lirs_validation.report import pictures
from lirs_validation.report.pictures import INK, run_figure
from lirs_validation.report.run_report import Report, report_of, report_page
from lirs_validation.report.run_tables import group_table, summary_table
from lirs_validation.report.table import MetricSpread
from lirs_wct.formats.drive_files import write_tum
from lirs_wct.formats.map_server import write_map
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Trajectory
from tests.command_line import run_command
from tests.lirs_validation.records import entry, saved

pytestmark = pytest.mark.usefixtures("empty_charts")
AS_SVG = pictures.as_svg


def reported(root: Path) -> tuple[Report, str]:
    report = report_of(read_results(root))
    return report, report_page(report, "lirs-wct report out -o report.html")


class Reader(HTMLParser):
    """Checks that tags close in order, and collects what a page shows and refers to."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two mappers in two worlds with three seeds; one run tipped, one raised, one folder is damaged."""
    root = tmp_path_factory.mktemp("mixed")
    rng = np.random.default_rng(0)
    for world in ("simple", "medium"):
        for mapper in ("hector", "gmapping"):
            for seed in (1, 2, 3):
                saved(root, world, seed, mapper=mapper, rtf=40 + rng.random(), ate=0.02 + 0.01 * rng.random())
    saved(root, "advanced", 1, status="tipped", ate=9.0)
    saved(root, "advanced", 2, status="error", mapper="my<b>.mapper:Own")
    (root / "broken").mkdir()
    (root / "broken" / "record.json").write_text("{ not json")
    (root / "sweep.json").write_text(json.dumps({"command": "lirs-wct validate --seeds 1-3", "suite": None}))
    return root


def test_the_page_is_whole_and_needs_nothing_else(mixed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "as_svg", AS_SVG)
    _, html = reported(mixed)
    reader = Reader(html)
    assert not any(tag in ("script", "link", "iframe", "object") for tag, _ in reader.seen)
    for tag, attributes in reader.seen:
        for name in ("src", "href", "xlink:href"):
            target = attributes.get(name)
            assert target is None or target.startswith(("#", "data:image/")), (tag, target)
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
        if tag == "img":
            assert attributes["alt"]
            assert "loading" not in attributes, "a screenshot shows what is loaded"
        if tag == "svg":
            assert attributes["aria-label"]
    assert "url(http" not in html
    assert "@import" not in html
    assert INK not in html
    assert "prefers-color-scheme: dark" in html
    ids = [attributes["id"] for tag, attributes in reader.seen if "id" in attributes and tag != "path"]
    anchors = {a["href"] for tag, a in reader.seen if tag == "a"}
    assert {anchor.removeprefix("#") for anchor in anchors if anchor} <= set(ids)


def test_failures_come_first_and_are_in_no_mean(mixed: Path) -> None:
    report, html = reported(mixed)
    assert html.index("it ended: tipped") < html.index(">Summary</h2>")
    assert "ValueError: broken" in html
    assert "my&lt;b&gt;.mapper:Own" in html
    assert "my<b>" not in html
    assert "not a run&#39;s record, or damaged" in html
    advanced = next(
        row for row in report.tables["summary"].rows if row[0] == "advanced" and row[1] == "hector"
    )
    assert advanced[2] == "0 of 1"
    assert all(isinstance(c, MetricSpread) and c.values is None for c in advanced[3:])


def test_means_and_intervals_are_those_of_the_records(mixed: Path) -> None:
    report, _ = reported(mixed)
    (ate,) = metrics_named(["trajectory.ate_rmse"])
    runs = by_group(report.entries)[RunGroup.of(entry("simple", mapper="gmapping"))]
    expected = repeats([run["trajectory"]["ate_rmse"] for run in runs])
    assert expected is not None
    table = group_table("t", "T", [ate], report.entries)
    row = next(r for r in table.rows if r[:2] == ("simple", "gmapping"))
    spread = row[-1]
    assert isinstance(spread, MetricSpread)
    assert spread.values == expected
    assert str(spread) == f"{expected.mean:.3f} ± {expected.half_width:.3f}"
    rows = list(csv.DictReader(io.StringIO(table.as_csv())))
    line = next(r for r in rows if r["world"] == "simple" and r["mapper"] == "gmapping")
    assert float(line["ATE [m]"]) == expected.mean
    assert float(line["ATE [m] std"]) == expected.std
    assert line["ATE [m] n"] == "3"
    assert str(spread) in table.as_markdown()
    assert "3 seeds" in report.subtitle


def test_a_mean_says_how_many_values_it_holds(tmp_path: Path) -> None:
    """A map of open ground has no walls: of three runs the mean was over one, and nothing said so."""
    for seed, f1 in ((1, 0.8), (2, None), (3, None)):
        saved(tmp_path, seed=seed, f1=f1)
    report, html = reported(tmp_path)
    heading = report.tables["summary"].headings.index("walls agree [%]")
    spread = report.tables["summary"].rows[0][heading]
    assert isinstance(spread, MetricSpread)
    assert str(spread) == "80 (1 of 3)"
    assert "(n of N): n of the N runs have this value." in report.tables["summary"].caption
    assert "median walls agree [%] (1 of 3 runs)" in html
    line = next(csv.DictReader(io.StringIO(report.tables["summary"].as_csv())))
    assert (line["walls agree [%] n"], line["walls agree [%] of"], line["ATE [m] of"]) == ("1", "3", "3")


def test_seeds_are_counted_in_each_group(tmp_path: Path) -> None:
    """Two worlds with one seed each are no two seeds; groups of two and three seeds are told apart."""
    for world, seed in (("simple", 1), ("medium", 2)):
        saved(tmp_path / "one", world, seed)
    report, html = reported(tmp_path / "one")
    assert report.seeds == (1, 1)
    assert "one seed: no confidence interval" in report.subtitle
    assert "One seed: one run&#39;s values, without any interval." in html
    assert "±" not in report.tables["summary"].as_markdown()
    assert "<b>1</b><span>seed</span>" in html
    for world, seed in (("simple", 1), ("simple", 2), ("simple", 3), ("medium", 2), ("medium", 9)):
        saved(tmp_path / "more", world, seed)
    saved(tmp_path / "more", "medium", 4, status="error")
    report, html = reported(tmp_path / "more")
    assert report.seeds == (2, 3)
    assert "6 runs; 2 to 3 seeds." in report.subtitle
    assert "<b>2 to 3</b><span>seeds</span>" in html


def test_each_group_is_shown_where_not_all_pictures_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for world, seed in (("simple", 1), ("simple", 2), ("medium", 2), ("medium", 3)):
        saved(tmp_path, world, seed)
    monkeypatch.setattr("lirs_validation.report.run_report.MAX_PICTURES", 3)
    _, html = reported(tmp_path)
    assert "Shown are 2 of 4 runs: the first seed of each group." in html
    named = re.findall(r"<figcaption>(\w+), .* seed (\d)", html)
    assert sorted(named) == [("medium", "2"), ("simple", "1")]


@pytest.mark.parametrize("other", [{"mapper": "gmapping"}, {"attitude": "none"}, {"robot": "jackal"}])
def test_cards_mix_no_methods(tmp_path: Path, other: dict[str, str]) -> None:
    saved(tmp_path, seed=1, ate=0.01)
    saved(tmp_path, seed=2, ate=0.03)
    _, alone = reported(tmp_path)
    assert "<b>0.020</b><span>median ATE [m]</span>" in alone
    assert "<span>median ATE of odometry [m]</span>" in alone
    saved(tmp_path, seed=1, ate=0.09, **other)
    _, mixed = reported(tmp_path)
    assert "<span>median" not in mixed
    assert "<span>RTF</span>" not in mixed
    assert "<b>3 of 3</b><span>runs finished</span>" in mixed


def test_what_ran_beside_others_has_no_rtf_and_what_was_stopped_is_marked() -> None:
    runs = [entry(seed=1, rtf=40.0), entry(seed=2, rtf=4.0, concurrent=True), entry(seed=3, rtf=42.0)]
    stopped = [entry("medium", 1, rtf=0.02, extrapolated=True, status="wall limit")]
    table = summary_table(runs + stopped)
    column = table.headings.index("RTF")
    here, there = (row[column] for row in table.rows)
    assert isinstance(here, MetricSpread)
    assert here.values == repeats([40.0, 42.0])
    assert isinstance(there, MetricSpread)
    assert str(there) == "0.0200†"
    assert "RTF of 1 run not given: other runs used the processor." in table.caption
    assert "† extrapolated" in table.caption
    assert table.rows[0][table.headings.index("ATE [m]")].values.count == 3  # type: ignore[union-attr]


def test_a_page_of_failures_alone_is_a_page(tmp_path: Path) -> None:
    saved(tmp_path, status="timeout")
    report, html = reported(tmp_path)
    Reader(html)
    assert "0 of 1" in html
    assert list(report.tables) == ["verdicts", "failures", "summary", "versions", "commands"]


def test_a_suites_page_tells_of_the_paper(tmp_path: Path) -> None:
    saved(tmp_path, "medium", 1, terrain="mesh", rays="mujoco")
    (tmp_path / "sweep.json").write_text(
        json.dumps({"suite": "paper", "command": "lirs-wct validate --suite paper"})
    )
    _, html = reported(tmp_path)
    for words in ("Table II: simple map", "Table IV: advanced map", "average RTF by robot", "not printed"):
        assert words in html
    assert "lirs-wct validate --suite paper" in html
    assert html.index("Table II: simple map") < html.index('id="verdicts-section"')


def with_files(folder: Path, seed: int) -> RunFolder:
    """Give a record's folder maps and paths: blocks of noise, worse than any map for a picture's size."""
    rng = np.random.default_rng(seed)
    p = np.kron(rng.choice((np.nan, 0.1, 0.9), (40, 40)), np.ones((10, 10)))
    grid = OccupancyGrid.from_probability(p, 0.05, Pose2(-10, -10))
    for name in ("map", "map_true_pose"):
        write_map(folder / name, grid)
    xy = np.cumsum(rng.normal(0, 0.1, (200, 2)), axis=0).tolist()
    for name in ("truth", "estimate"):
        path = Trajectory.from_poses((np.arange(200) * 0.04).tolist(), [Pose2(x, y) for x, y in xy])
        write_tum(folder / f"{name}.tum", path)
    return read_results(folder).runs[0]


def test_a_lost_source_costs_the_terrain_only(tmp_path: Path) -> None:
    run = with_files(saved(tmp_path, str(tmp_path / "gone.png")), 3)
    picture = run_figure(run, ScenarioCache())
    assert picture.picture.startswith("data:image/webp;base64,")
    assert "without its terrain" in picture.note
    assert "gone.png" in picture.note


@pytest.mark.slow
def test_a_hundred_runs_stay_under_two_megabytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take up to 3 MB: all the rest must stay under 2."""
    monkeypatch.setattr(pictures, "as_svg", AS_SVG)
    for seed in range(1, 6):
        for world in ("simple", "medium", "advanced", "depot", "dune"):
            for mapper in ("hector", "gmapping", "cartographer", "mine:Own"):
                saved(tmp_path, world, seed, mapper=mapper, rtf=30 + seed)
    report, html = reported(tmp_path)
    assert len(report.runs) == 100
    assert len(html.encode()) < 2_000_000


def test_the_command_writes_all_forms(
    mixed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, tables, text = tmp_path / "r.html", tmp_path / "tables", tmp_path / "r.md"
    files = ("-o", str(target), "--tables", str(tables), "--markdown", str(text))
    assert run_command("report", str(mixed), *files) == 0
    assert "skipped broken" in capsys.readouterr().err
    assert target.read_text().startswith("<!DOCTYPE html>")
    written = {path.stem for path in tables.glob("*.csv")}
    assert {"failures", "summary", "rtf", "rtf-runs", "trajectory", "map", "cost", "commands"} <= written
    with (tables / "rtf-runs.csv").open() as file:
        recorded = {
            (r["world"], r["mapper"], r["seed"]): float(r["RTF"]) for r in csv.DictReader(file) if r["RTF"]
        }
    for run in read_results(mixed).runs:
        e = run.entry
        if e["rtf"]:
            assert recorded[(e["world"]["name"], e["config"]["mapper"], str(e["seed"]))] == e["rtf"]["mean"]
    assert "| ± |" not in text.read_text()
    headings = [line for line in text.read_text().splitlines() if line.startswith("#")]
    assert headings == [
        f"# Validation runs in {mixed.name}",
        "## Verdict",
        "## Failures",
        "## Not read",
        "## Summary",
    ]


def test_a_report_judges_by_given_limits(tmp_path: Path) -> None:
    saved(tmp_path / "out", ate=0.1)
    (tmp_path / "limits.yaml").write_text("small_error: 0.01\ngain: 0.1\n")
    files = ("-o", str(tmp_path / "r.html"), "--markdown", str(tmp_path / "r.md"))
    for options, kind in (((), "works"), (("--limits", str(tmp_path / "limits.yaml")), "adds nothing")):
        assert run_command("report", str(tmp_path / "out"), *files, *options) == 0
        assert f"| simple | hector | {kind} | hector on husky {kind}" in (tmp_path / "r.md").read_text()
        assert kind in (tmp_path / "r.html").read_text()


def test_methods_as_published_have_one_row_per_world(tmp_path: Path) -> None:
    for seed in (1, 2):
        saved(tmp_path, "medium", seed, mapper="hector", ate=0.02)
        saved(tmp_path, "medium", seed, mapper="hector_original", ate=1.5)
        saved(tmp_path, "medium", seed, mapper="hector", ate=0.9, attitude="none")
    report, html = reported(tmp_path)
    assert '<a href="#methods-section">As published</a>' in html
    assert html.index('id="methods-section"') < html.index('id="trajectory-section"')
    for key in ("as-published", "without-attitude"):
        (row,) = report.tables[key].texts()
        assert [row[3], row[5]] == ["loses its way (2 of 2)", "works (2 of 2)"]


def test_a_mapper_that_is_worse_than_its_odometry_is_marked_in_every_table(tmp_path: Path) -> None:
    saved(tmp_path, "medium", 1, mapper="hector", ate=0.02)
    saved(tmp_path, "medium", 1, mapper="gmapping", ate=0.45)
    saved(tmp_path, "medium", 2, mapper="gmapping", ate=0.01)
    report, html = reported(tmp_path)
    line = "‡ worse than its odometry: medium, gmapping (1 of 2 runs)."
    assert line in report.tables["summary"].caption
    assert line in report.tables["trajectory"].caption
    marked = re.findall(r'<tr class="worse">.*?</tr>', html)
    assert len(marked) == 3  # summary, trajectory by group and by run
    assert all("gmapping" in row and "0.200" in row for row in marked)
    assert len(re.findall("</tr>", html)) > 3 * len(marked)
