"""A full disk says so in one line, and leaves nothing half-written."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.live.options import LiveOptions
from lirs_extensions.live.run import live
from lirs_extensions.search.twin.twin import run_twin
from lirs_validation import RunConfig, map_log, validate
from lirs_validation.config import MapConfig
from lirs_wct.errors import OutputError
from lirs_wct.formats.map_server import write_map
from lirs_wct.formats.picture import write_image
from lirs_wct.geometry import OccupancyGrid
from tests.command_line import run_command

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT / "examples" / "data"
SMALL = ("--size", "20", "--height", "2", "--option", "resize=129,129")


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, bytes: writing more fails as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_picture_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    """`cv2.imwrite` returned False, and half a picture stood where a map was to be."""
    noise = np.random.default_rng(0).integers(0, 256, (300, 300), np.uint8)
    grid = OccupancyGrid.from_probability(noise / 255.0, 0.05)
    with largest_file(20_000):
        for suffix in (".png", ".pgm"):
            with pytest.raises(OutputError, match="cannot be written: File too large"):
                write_image(tmp_path / f"noise{suffix}", noise)
        with pytest.raises(OutputError, match=r"map\.pgm: cannot be written"):
            write_map(tmp_path / "map", grid)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match=r"noise\.xyz: cannot be encoded"):
        write_image(tmp_path / "noise.xyz", noise)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "size"),
    [
        (("build", str(DATA / "dunes.png"), "--to", "mjcf"), 15_000),  # the ground's texture
        (("build", str(DATA / "dunes.png"), "--to", "dae,sdf"), 15_000),
        (("map", "scans.clf.gz", "--mapper", "hector", "--second", "none"), 15_000),
        (("validate", "simple", *SMALL, "--seconds", "0.4"), 15_000),
        (("validate", "simple", *SMALL, "--seconds", "0.4", "--seed", "1,2"), 15_000),
    ],
)
def test_a_command_on_a_full_disk_says_so_in_one_line(
    words: tuple[str, ...],
    size: int,
    finished_run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(finished_run)
    # With room first: kernels that are compiled under the limit could not be cached.
    assert run_command(*words, "-o", str(tmp_path / "roomy")) == 0
    capsys.readouterr()
    with largest_file(size):
        assert run_command(*words, "-o", str(tmp_path / "full")) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("lirs-wct: ")]
    assert len(said) == 1
    assert "cannot be written: File too large" in said[0]
    assert [path for path in (tmp_path / "full").rglob("*") if path.is_file()] == []


@pytest.mark.slow
def test_a_full_disk_leaves_the_former_report(
    sweep_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "report.html"
    words = ("report", str(sweep_folder), "-o", str(page))
    assert run_command(*words) == 0
    former = page.read_bytes()
    capsys.readouterr()
    with largest_file(3000):
        assert run_command(*words) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("lirs-wct: ")]
    assert said == [f"lirs-wct: {page}: cannot be written: File too large"]
    assert page.read_bytes() == former
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html"]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_terminal_without_room_is_said() -> None:
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-c", "from lirs_validation.cli.app import main; main()", "list", "mappers"],
            env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'envs'}"},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert "output: cannot be written: No space left on device" in ended.stderr


@pytest.mark.parametrize(
    "work",
    [
        lambda out: validate("no-source.png", out=out),
        lambda out: map_log("no-log.clf", out=out),
        lambda out: run_twin(MapConfig(log="no-log.clf"), lidar="lms200", seed=1, out=out),
        lambda out: list(live(RunConfig(source="no-source.png", mapper="gmapping"), LiveOptions(), out=out)),
    ],
)
def test_an_output_folder_that_cannot_be_written_is_refused_first(
    tmp_path: Path, work: Callable[[Path], object]
) -> None:
    """The drive or the mapping was made before, and then lost."""
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file is a file"):
        work(tmp_path / "file" / "out")
