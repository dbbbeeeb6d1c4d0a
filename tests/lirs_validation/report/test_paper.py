"""The paper's tables and findings beside ours."""

from typing import Any

from lirs_validation.record.metric_catalog import significant
from lirs_validation.report.paper import findings_table, paper_tables
from lirs_validation.sweep.tasks import VIEWS
from tests.lirs_validation.records import entry


def suite(heightmap: float, solid: float, order: tuple[str, ...]) -> list[dict[str, Any]]:
    """Runs of the paper's suite: the first method in `order` fastest; heightmaps slower world by world."""
    runs = []
    for k, world in enumerate(("simple", "medium", "advanced")):
        for rank, mapper in enumerate(order):
            for view, (terrain, rays) in VIEWS.items():
                base = {"heightmap-based": heightmap / (k + 1), "solid-based": solid, "ours": 40.0}[view]
                rtf = base * (1 - 0.1 * rank)
                runs.append(entry(world, rtf=rtf, mapper=mapper, terrain=terrain, rays=rays))
    return runs


def answers(runs: list[dict[str, Any]]) -> list[str]:
    return [row[1] for row in findings_table(runs).texts()]


def test_the_papers_findings_where_they_hold() -> None:
    assert answers(suite(0.05, 0.6, ("hector", "cartographer", "gmapping"))) == ["holds"] * 5


def test_the_papers_findings_where_they_do_not() -> None:
    found = findings_table(suite(2.0, 0.2, ("gmapping", "cartographer", "hector"))).texts()
    assert [row[1] for row in found] == ["does not hold", "holds", *["does not hold"] * 3]
    assert "in 0 of 9 comparisons" in found[2][2]
    assert "else GMapping (simple heightmap-based, simple solid-based, simple ours, " in found[2][2]


def test_findings_need_runs() -> None:
    assert answers([]) == ["cannot be said"] * 5
    some = [
        r for r in suite(0.05, 0.6, ("hector", "cartographer", "gmapping")) if r["world"]["name"] == "medium"
    ]
    assert answers(some) == ["holds", "cannot be said", "holds", "holds", "holds"]
    shared = [entry(r["world"]["name"], rtf=0.05, concurrent=True) for r in some]
    assert answers(shared) == ["cannot be said"] * 5


def test_an_empty_cell_says_why() -> None:
    runs = [
        entry("medium", concurrent=True, mapper="gmapping"),
        entry("medium", status="lost", mapper="hector"),
    ]
    table = paper_tables(runs)[1]
    assert [row[5] for row in table.texts()] == ["not given", "failed: lost", "not run"]
    assert "RTF of 1 run not given" in table.caption


def test_the_papers_tables_stand_beside_ours() -> None:
    tables = {s.key: s for s in paper_tables(suite(0.05, 0.6, ("hector", "cartographer", "gmapping")))}
    texts = {key: table.texts() for key, table in tables.items()}
    assert texts["table-III"][0] == ["GMapping", "0.04", "0.0200", "0.46", "0.480", "32.0"]
    assert texts["table-IV"][1][:4] == ["HectorSLAM", "0.012", "0.0167", "0.60"]
    assert [row[1] for row in texts["table-II"]] == ["not printed"] * 3
    assert "prints this table empty" in tables["table-II"].caption
    means = {row[0]: row[1:] for row in texts["robots"]}
    assert means["husky"] == ["0.38", significant(0.6 * 0.9), "36.0"]
    assert means["turtlebot2"] == ["0.52", "not run", "not run"]
    assert means["jackal"][0] == "0.47"
