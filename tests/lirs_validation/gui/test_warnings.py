"""The page says of a file what `info` says, by the labels of its controls; without a browser."""

import json
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

viser = pytest.importorskip("viser", reason="viser is not installed (extra [gui])")

from lirs_validation.experiment.scenario import ScenarioCache  # noqa: E402
from lirs_validation.gui.construction import JOINED, Uploads  # noqa: E402
from lirs_validation.gui.controls import without_flags  # noqa: E402
from lirs_validation.gui.page import Guard  # noqa: E402
from lirs_validation.gui.tabs import WorldTab  # noqa: E402
from lirs_wct.progress import no_progress  # noqa: E402
from tests.command_line import run_command  # noqa: E402


class Tab(WorldTab):
    """The world's tab of a page without a client, which does its jobs at once."""

    def __init__(self, gui: Any) -> None:
        self.shown_lines: list[str] = []
        client = SimpleNamespace(gui=gui, add_notification=self._notify)
        self.uploads, guard = Uploads(), Guard(client)  # type: ignore[arg-type]
        page = SimpleNamespace(client=client, guard=guard, uploads=self.uploads, scenarios=ScenarioCache())
        page.worker = SimpleNamespace(submit=lambda _, job: guard(lambda _: job())(None))
        page.scene = SimpleNamespace(show_world=lambda world, coarse: 0)
        page.progress = lambda work: nullcontext(no_progress)
        self.guard = guard
        super().__init__(page, None, lambda: None)  # type: ignore[arg-type]

    def _notify(self, title: str, message: str, color: str) -> Any:
        self.shown_lines = message.splitlines()
        return SimpleNamespace(remove=self.shown_lines.clear)

    def upload(self, *paths: Path) -> list[str]:
        """Open files in one upload; return the lines that the page then shows."""
        self.shown_lines = []
        head = JOINED + json.dumps([(path.name, path.stat().st_size) for path in paths]).encode() + b"\n"
        content = b"".join(path.read_bytes() for path in paths)
        self.open(", ".join(path.name for path in paths), content if len(paths) == 1 else head + content)
        return sorted(self.shown_lines)


@pytest.fixture
def tab() -> Iterator[Tab]:
    server = viser.ViserServer(port=0, verbose=False)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        tab = Tab(server.gui)
        warnings.showwarning = lambda message, *_: tab.guard.note(message)
        yield tab
    tab.uploads.close()
    server.stop()


@pytest.fixture
def said_by_info(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[str]]:
    """Return a function that gives the lines of `info` about a file, options named as on the page."""
    monkeypatch.setenv("COLUMNS", "1000")

    def said(path: Path) -> list[str]:
        with warnings.catch_warnings():
            run_command("info", str(path))
        printed = capsys.readouterr()
        lines = re.findall("^lirs-wct: (.*)", printed.err, re.M)
        lines += re.findall(f"^({re.escape(str(path))}: not fit .*)", printed.out, re.M)
        rows = re.findall("(?:deviation|put right) *[^ ] (.*?) *[^ ]$", printed.out, re.M)
        lines += [f"{path}: {row}" for row in rows]
        return sorted({without_flags(line.replace(f"{path.parent}/", "")) for line in lines})

    return said


REAL = (
    ["maps/navigation_tutorials/willow-full.pgm"],
    ["maps/navigation2/depot.pgm", "maps/navigation2/depot.yaml"],
    ["maps/navigation/testmap2.png"],
    ["reports/worlds/alpha.png", "reports/worlds/alpha_090.yaml"],
    ["reports/worlds/far_map.pgm", "reports/worlds/far_map.yaml"],
    ["reports/worlds/feet_2263.tif"],
    ["reports/worlds/hole_-32767.tif"],
    ["reports/worlds/mat_partial.dae"],
    ["reports/worlds/yup.obj"],
    ["reports/worlds/worldfile.tif", "reports/worlds/worldfile.tfw"],
    ["height/gz-common__dem_moon.tif"],
    ["stl/unitree_mujoco__terrain.STL"],
    ["logs/orebro/orebro.clf.gz"],
)


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize("names", REAL, ids=lambda names: Path(names[-1]).name)
def test_page_and_info_say_the_same(
    tab: Tab, said_by_info: Callable[..., list[str]], shared_data: Path, names: list[str]
) -> None:
    paths = [shared_data / name for name in names]
    main = next((path for path in paths if path.suffix == ".yaml"), paths[0])
    assert tab.upload(*paths) == said_by_info(main)
    assert tab.shown is not None
    (folder,) = tab._mapping._folders.values()  # topics, clock, mapper
    assert folder.visible == (".clf" in main.suffixes)


@pytest.mark.slow
@pytest.mark.shared
def test_damaged_files_get_the_line_of_info(
    tab: Tab, said_by_info: Callable[..., list[str]], shared_data: Path, picture: Path
) -> None:
    tab.upload(picture)
    kept, refused = tab.shown, 0
    for path in sorted((shared_data / "broken").iterdir()):
        lines = tab.upload(path)
        assert lines == said_by_info(path)
        if tab.shown is kept:
            refused += 1
            assert len(lines) == 1
        tab.upload(picture)
        kept = tab.shown
    assert refused > 5


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    """A picture of a room, without YAML."""
    pixels = np.full((60, 80), 254, np.uint8)
    pixels[:2] = pixels[-2:] = pixels[:, :2] = pixels[:, -2:] = 0
    cv2.imwrite(str(tmp_path / "room.pgm"), pixels)
    return tmp_path / "room.pgm"


def test_a_picture_of_a_map_is_read_as_one_by_a_button(tab: Tab, plan: Path, picture: Path) -> None:
    said = "room.pgm: looks like a laser map: give its YAML file, or kind map with resolution"
    assert tab.upload(plan) == [said]
    assert tab._as_map.visible
    tab._read_as_map()
    assert tab.shown is not None
    assert tab.shown.world.kind == "map"
    assert tab.shown.world.surface.size == pytest.approx((4.0, 3.0))
    assert tab.shown_lines == ["room.pgm: 0.05 m a pixel, unless resolution is given"]
    assert not tab._as_map.visible
    next(handle for control, handle in tab._options._shown if control.name == "resolution").value = "0.1"
    tab.preview()
    assert tab.shown.world.surface.size == pytest.approx((8.0, 6.0))
    assert tab.upload(picture) == []
    assert tab.shown.world.kind == "terrain"
    assert tab.shown.options.kind is None


def test_files_of_one_upload_belong_together(tab: Tab, plan: Path, picture: Path, tmp_path: Path) -> None:
    (tmp_path / "room.yaml").write_text("image: room.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    for paths in ((tmp_path / "room.yaml", plan), (plan, tmp_path / "room.yaml")):
        assert tab.upload(*paths) == []
        assert tab.shown is not None
        assert tab.shown.world.surface.size == (8.0, 6.0)
        assert tab._source.value == "room.yaml"
    (tmp_path / "hill.pgw").write_text("0.5\n0\n0\n-0.5\n0\n0\n")
    tab.upload(tmp_path / "hill.pgw", picture)
    assert tab.shown.world.surface.size == (32.0, 32.0)
    (tmp_path / "slab.obj").write_text("v 0 0 0\nv 9 0 1\nv 0 9 2\nv 9 9 0\nf 1 2 3\nf 2 4 3\n")
    tab.upload(picture, tmp_path / "slab.obj")
    assert tab.shown.world.kind == "terrain"
    assert tab._source.value == "slab.obj"
    assert tab.shown.options.texture == tab.uploads.folder / "hill.png"
    assert "hill.pgw" not in tab._source.options


def test_a_refused_file_brings_the_former_one_back(tab: Tab, picture: Path, tmp_path: Path) -> None:
    tab.upload(picture)
    kept, content = tab.shown, picture.read_bytes()
    picture.write_bytes(content[:100])
    lines = tab.upload(picture)
    assert len(lines) == 1
    assert lines[0].startswith("hill.png: ")
    assert tab.shown is kept
    assert (tab.uploads.folder / "hill.png").read_bytes() == content
    (tmp_path / "notes.txt").write_text("hello")
    assert [line.partition(":")[0] for line in tab.upload(tmp_path / "notes.txt")] == ["notes.txt"]
    assert tab.shown is kept


@pytest.mark.slow
def test_unusual_files_get_the_lines_of_info(
    tab: Tab, said_by_info: Callable[..., list[str]], tmp_path: Path
) -> None:
    holes = np.linspace(0, 9, 64 * 64, dtype=np.float32).reshape(64, 64)
    holes[20:30, 20:30] = np.nan
    cv2.imwrite(str(tmp_path / "holes.tif"), holes)
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((9, 9), 7, np.uint8))
    for name in ("holes.tif", "flat.png"):
        lines = tab.upload(tmp_path / name)
        assert len(lines) == 1
        assert lines == said_by_info(tmp_path / name)


def test_a_large_model_shows_window_and_spacing(tab: Tab, tmp_path: Path) -> None:
    z = np.random.default_rng(1).random((30, 40)) * 50
    rows = "\n".join(" ".join(f"{value:.2f}" for value in row) for row in z)
    (tmp_path / "a.asc").write_text(f"ncols 40\nnrows 30\nxllcorner 0\nyllcorner 0\ncellsize 10\n{rows}\n")
    tab.upload(tmp_path / "a.asc")
    assert tab.shown is not None
    facts = dict(tab.shown.facts)
    assert facts["surface"] == "40 x 30 nodes, 10 m apart"
    assert facts["x and y"] == "-195 to 195 m, -145 to 145 m"
    assert facts["window"].startswith("a drive takes 50 m")
    assert facts["samples"].startswith("10 m apart: too far for husky, ")
