"""Shared fixtures: the folder of real inputs, quiet numba."""

import os
import shutil
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

# Waiting BLAS threads spin: beside other processes a fit of a millisecond takes a second.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

import lirs_envs  # noqa: F401  before mujoco, so that it renders without a screen
from lirs_wct.sources import picture
from lirs_wct.sources.bundled import BundledPicture

pytest_plugins = ["tests.cpu_time"]

# Kernels compile inside the first example; a shared machine is slow at times.
settings.register_profile("local", deadline=None, max_examples=25)
settings.register_profile("ci", settings.get_profile("local"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") == "true" else "local")

FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
"""Flags of Chromium: 3D without a graphics card."""
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real pictures, maps and logs; absent outside the developers' machines."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("shared/data is not beside the checkout")
    return folder


@pytest.fixture(scope="session", autouse=True)
def pictures_of_bundled_worlds() -> Iterator[None]:
    """Make the picture of each bundled world once; 0.4 s each."""

    @cache
    def made(name: str) -> BundledPicture:
        found = make(name)
        found.pixels.flags.writeable = found.hills.flags.writeable = False
        return found

    make = picture.bundled_picture
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(picture, "bundled_picture", made)
        yield


@pytest.fixture(scope="module")
def plain_pictures() -> Iterator[None]:
    """White pictures in the folders of runs and maps: drawing takes 0.5 s, and few tests look at them."""
    from lirs_wct.drawing.canvas import bare_figure

    with pytest.MonkeyPatch.context() as patch:
        for name in ("overview_figure", "map_overview"):
            patch.setattr(f"lirs_validation.drawing.{name}", lambda *_: bare_figure(1, 1))
        yield


@pytest.fixture
def empty_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts without content in reports: drawing them takes most of the time."""
    empty = '<svg role="img" aria-label="{}"></svg>'
    as_svg = "lirs_validation.report.pictures.as_svg"
    monkeypatch.setattr(as_svg, lambda figure, label, key: empty.format(label))


@pytest.fixture(scope="session")
def recorded_results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recorded results (tests/make_data.py), a folder of results each: run, mapped, sweep."""
    folder = tmp_path_factory.mktemp("recorded")
    for packed in (ROOT / "tests" / "data").glob("*.zip"):
        with zipfile.ZipFile(packed) as file:
            file.extractall(folder / packed.stem)
    return folder


@pytest.fixture(scope="session")
def finished_run(recorded_results: Path) -> Path:
    """Folder of a run of hector on a jackal in `simple`: 10 s, 101 scans; read only."""
    return next(recorded_results.glob("run/*/record.json")).parent


@pytest.fixture(scope="session")
def mapped_log(recorded_results: Path) -> Path:
    """Folder of hector's map of that run's scans, without truth; read only."""
    return next(recorded_results.glob("mapped/*/record.json")).parent


@pytest.fixture(scope="session")
def sweep_folder(recorded_results: Path) -> Path:
    """Folder of results of two runs of 2 s, hector and gmapping; read only."""
    return recorded_results / "sweep"


@pytest.fixture
def finished_run_copy(finished_run: Path, tmp_path: Path) -> Path:
    """A copy of the finished run to write in, alone in a folder of results."""
    return shutil.copytree(finished_run, tmp_path / "results" / finished_run.name)


@pytest.fixture
def sweep_copy(sweep_folder: Path, tmp_path: Path) -> Path:
    """A copy of the sweep to write in."""
    return shutil.copytree(sweep_folder, tmp_path / "sweep")


@pytest.fixture(scope="session")
def in_ci() -> bool:
    return os.environ.get("CI") == "true"


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium; Playwright runs once in a process."""
    api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("chromium is not installed (apt-get install chromium)")
    with api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield launched
        launched.close()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test of a page in a browser as slow."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
