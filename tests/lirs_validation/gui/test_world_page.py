"""The construction page in a real browser: open, change, build, download, err and go on."""

import io
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lirs_wct.formats.drive_files import write_scans
from lirs_wct.world import World
from tests.lirs_validation.gui.pages import drop, field, upload, wait_for

pytestmark = pytest.mark.slow
Open = Callable[..., Any]


def test_a_picture_is_opened_changed_built_and_downloaded(
    open_page: Open, picture: Path, tmp_path: Path
) -> None:
    page = open_page()
    upload(page, "Open files", picture)
    page.get_by_text("hill (terrain)").wait_for()
    page.get_by_text("0.000 to 6.000 m").wait_for()
    begun = time.monotonic()
    field(page, "z axis scale").fill("2")
    page.get_by_text("0.000 to 12.000 m").wait_for()
    assert time.monotonic() - begun < 10
    field(page, "height").fill("3")
    page.get_by_text("0.000 to 6.000 m").wait_for()
    page.get_by_role("button", name="Build").click()
    page.get_by_text("watertight").wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the package").click()
    archive = zipfile.ZipFile(io.BytesIO(Path(download.value.path()).read_bytes()))
    assert {"hill/world.json", "hill/model.sdf", "hill/meshes/hill.dae", "hill/hill.xml"} <= set(
        archive.namelist()
    )
    archive.extractall(tmp_path)
    world = World.load(tmp_path / "hill")
    assert world.surface.relief == 6.0
    assert world.surface.size == (50.0, 50.0)
    assert len(world.file_mesh.faces) < 2 * 64 * 64
    page.get_by_text(f"{len(world.file_mesh.faces)}", exact=True).first.wait_for()


def test_what_is_wrong_is_said_once_and_the_page_lives_on(
    open_page: Open, picture: Path, tmp_path: Path
) -> None:
    page = open_page()
    upload(page, "Open files", picture)
    page.get_by_text("hill (terrain)").wait_for()
    field(page, "height").fill("tall")
    page.get_by_text("height must be a number, got 'tall'").wait_for()
    field(page, "height").fill("-3")
    page.get_by_text("height must be a finite number above 0, got -3").wait_for()
    wait_for(lambda: page.get_by_text("Input cannot be used").count() == 1)
    field(page, "height").fill("4")
    page.get_by_text("0.000 to 4.000 m").wait_for()
    page.get_by_text("Input cannot be used").wait_for(state="detached")
    holes = np.linspace(0, 9, 64 * 64, dtype=np.float32).reshape(64, 64)
    holes[20:30, 20:30] = np.nan
    cv2.imwrite(str(tmp_path / "holes.tif"), holes)
    upload(page, "Open files", tmp_path / "holes.tif")
    page.get_by_text("holes.tif: 100 of 4096 pixels have no height").wait_for()
    broken = tmp_path / "broken.png"
    broken.write_bytes(picture.read_bytes()[:200])
    upload(page, "Open files", broken)
    page.get_by_text("broken.png:").wait_for()
    assert str(tmp_path) not in page.content()
    text = tmp_path / "notes.txt"
    text.write_text("hello")
    upload(page, "Open files", text)
    page.get_by_text("notes.txt: ").wait_for()


def test_a_map_and_its_picture_are_dropped_together(open_page: Open, tmp_path: Path) -> None:
    pixels = np.full((60, 80), 254, np.uint8)
    pixels[:2] = pixels[-2:] = pixels[:, :2] = pixels[:, -2:] = 0
    cv2.imwrite(str(tmp_path / "room.pgm"), pixels)
    (tmp_path / "room.yaml").write_text("image: room.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    page = open_page()
    drop(page, tmp_path / "room.yaml", tmp_path / "room.pgm")
    page.get_by_text("room (map)").wait_for()
    page.get_by_text("8 x 6 m").wait_for()
    page.locator("label", has_text="wall height").wait_for()
    assert not page.locator("label", has_text="smoothing").count()


def test_logs_and_compressed_bags_are_dropped(open_page: Open, tmp_path: Path) -> None:
    from lirs_wct.formats.rosbag.messages import BagDrive
    from lirs_wct.formats.rosbag.open_bag import zstd
    from lirs_wct.formats.rosbag.writer import write_bag
    from tests.lirs_wct.formats.rosbag import drives

    ticks = drives.drive(40).ticks
    log, bag = tmp_path / "office.clf.gz", tmp_path / "walls_0.mcap.zstd"
    write_scans(log, [(tick.scan, tick.odometry) for tick in ticks])
    write_bag(tmp_path / "walls", BagDrive(ticks=ticks))
    bag.write_bytes(zstd.compress((tmp_path / "walls" / "walls.mcap").read_bytes()))
    page = open_page()
    for path in (log, bag):
        drop(page, path)
        page.get_by_text(f"{path.name.partition('.')[0]} (map)").wait_for()
        page.locator("label", has_text="wall height").wait_for()
    (tmp_path / "cut.mcap.zstd").write_bytes(bag.read_bytes()[:30])
    drop(page, tmp_path / "cut.mcap.zstd")
    page.get_by_text("cut.mcap.zstd: not a bag that can be read").wait_for()


def test_two_pages_do_not_disturb_each_other_and_leave_nothing_behind(
    open_page: Open, server: Any, picture: Path
) -> None:
    first, second = open_page(), open_page()
    upload(first, "Open files", picture)
    first.get_by_text("hill (terrain)").wait_for()
    assert second.get_by_text("simple (terrain)").is_visible()
    assert not second.get_by_text("hill").count()
    pages = server.pages
    assert len(pages) == 2
    folders = [page.uploads.folder for page in pages]
    assert len(set(folders)) == 2
    assert all(folder.is_dir() for folder in folders)
    first.close()
    second.close()
    wait_for(lambda: not server.pages)
    assert all(page.worker.join(20) for page in pages)
    assert not any(folder.exists() for folder in folders)
