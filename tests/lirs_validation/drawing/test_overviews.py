"""Overviews of runs and mapped logs: no text lies on another one."""

from itertools import pairwise
from pathlib import Path

from lirs_validation import map_log, validate
from lirs_wct.drawing.canvas import Drawing
from tests.lirs_validation.drawing.test_pictures import boxes_apart


def rows_apart(figure: Drawing) -> None:
    """No two names, and no two values, of a list of metrics lie on one another."""
    figure.draw_without_rendering()
    for axes in figure.axes:
        for side in ("left", "right"):
            boxes = [t.get_window_extent() for t in axes.texts if t.get_ha() == side]
            assert all(upper.y0 >= lower.y1 - 1 for upper, lower in pairwise(boxes))


def test_a_run_on_a_laser_map(room: str) -> None:
    figure = validate(room, seconds=0.5).overview()
    boxes_apart(figure)
    rows_apart(figure)


def test_a_log_with_plots_of_its_errors(finished_run: Path) -> None:
    mapped = map_log(
        finished_run / "scans.clf.gz", mapper="hector", second="none", reference=finished_run / "truth.tum"
    )
    figure = mapped.overview()
    assert len(figure.axes) == 3
    boxes_apart(figure)
    rows_apart(figure)
