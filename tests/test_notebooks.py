"""The notebooks run from top to bottom, show their pictures, and print little."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from nbformat import NotebookNode

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
MOST_TEXT = 2000
"""Characters that a cell may print."""
MOST_BYTES = 500_000
"""Of a notebook with its outputs."""


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_in_an_empty_folder(
    path: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path_factory.mktemp("site")
    monkeypatch.setenv("LIRS_QUICK", "1")
    # Other tests load the machine: then no run of the notebook would have an RTF.
    (site / "sitecustomize.py").write_text("import os\n\nos.getloadavg = lambda: (0.0, 0.0, 0.0)\n")
    monkeypatch.setenv("PYTHONPATH", str(site), prepend=os.pathsep)
    notebook = nbformat.read(path, as_version=4)
    from nbclient import NotebookClient  # here, since its import takes 0.3 s

    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    check_outputs(notebook)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_committed(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    check_outputs(notebook)
    assert path.stat().st_size < MOST_BYTES


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_sentence_follows_each_result_and_terms_are_defined(path: Path) -> None:
    cells = nbformat.read(path, as_version=4).cells
    for cell, following in zip(cells, [*cells[1:], None], strict=True):
        outputs = cell.get("outputs", ())
        if any(output.output_type == "execute_result" for output in outputs):
            assert following is not None, cell.source
            assert following.cell_type == "markdown", cell.source
    text = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    for term in ("ATE", "F1", "RTF"):
        if re.search(rf"\b{term}\b", text):
            assert re.search(rf"\*?{term}\*? (is|\(|=)|\({term} =", text), term


def test_the_mapper_of_your_own_clearly_beats_dead_reckoning() -> None:
    cells = nbformat.read(ROOT / "notebooks" / "04_your_own_mapper.ipynb", as_version=4).cells
    printed = "".join(output.get("text", "") for cell in cells for output in cell.get("outputs", ()))
    errors = {name: float(ate) for name, ate in re.findall(r"my_mapper:(\w+): ATE ([\d.]+) m", printed)}
    assert errors["ScanMatcher"] < errors["DeadReckoning"] / 3
    assert "ScanMatcher on turtlebot2 works" in printed


def check_outputs(notebook: NotebookNode) -> None:
    """Check that the cells with the tag `picture` show one, the last one among them, and none prints much."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert "picture" in cells[-1].metadata.get("tags", ())
    for cell in cells:
        if "picture" in cell.metadata.get("tags", ()):
            assert any("image/png" in output.get("data", {}) for output in cell.outputs), cell.source
        assert sum(map(len, texts(cell))) < MOST_TEXT, cell.source


def texts(cell: NotebookNode) -> Iterator[str]:
    """Yield what a cell prints, and the text of what it shows."""
    for output in cell.outputs:
        yield output.get("text", "")
        yield output.get("data", {}).get("text/plain", "")
