"""Drive and replay in a real browser: the map grows, hands steer, a run is saved, opened again, and goes."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.lirs_validation.gui.pages import field, figure, upload, wait_for

pytestmark = pytest.mark.slow
Open = Callable[..., Any]


def _time(page: Any) -> float:
    return float(figure(page, "time").split()[0])


def test_drive_steer_save_and_replay(open_page: Open, server: Any, tmp_path: Path) -> None:
    page = open_page()
    page.get_by_role("tab", name="Drive").click()
    page.get_by_role("button", name="Start").click()
    page.get_by_text("driving").wait_for()
    drive = server.pages[0].drive.playback
    first = drive.moment(0).map
    wait_for(lambda: drive.time > 4.0)
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Go on").wait_for()
    stands = threading.Event()
    server.pages[0].worker.submit("stands", stands.set)  # after the scans that were on their way
    assert stands.wait(90)
    assert drive.moment(drive.scans - 1).map.grid.known.sum() > first.grid.known.sum()
    stood = drive.scans
    page.get_by_role("button", name="Step one scan").click()
    wait_for(lambda: drive.scans == stood + 1)
    wait_for(lambda: float(field(page, "timeline").input_value()) == round(drive.time, 1))  # "5" at 5.0 s
    assert figure(page, "ATE").endswith(" m")

    field(page, "timeline").fill("1")
    wait_for(lambda: figure(page, "time").startswith("1.0 "))
    assert drive.scans == stood + 1

    field(page, "drive by hand").click()
    page.get_by_text("drag, or hold").wait_for()
    server.pages[0].drive._speed.value = "1 x real time"  # no obstacle is reached while the keys are held
    page.get_by_role("button", name="Go on").click()
    page.keyboard.down("KeyW")
    page.keyboard.down("KeyA")
    wait_for(lambda: field(page, "stick").input_value() == "1.00 0.60")
    wait_for(lambda: drive.driver.touched)
    page.keyboard.up("KeyA")
    page.keyboard.up("KeyW")
    wait_for(lambda: field(page, "stick").input_value() == "0.00 0.00")
    box = page.locator(".lirs-stick").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - box["height"] / 6, steps=3)
    wait_for(lambda: field(page, "stick").input_value() == "0.50 0.00")
    page.mouse.up()
    wait_for(lambda: field(page, "stick").input_value() == "0.00 0.00")
    page.get_by_role("button", name="Pause").click()

    with page.expect_download() as download:
        page.get_by_role("button", name="Save the run").click()
    assert "-manual-" in download.value.suggested_filename
    archive = tmp_path / "run.zip"
    download.value.save_as(archive)
    driven = drive.time

    page.get_by_role("tab", name="Replay").click()
    upload(page, "Open a zipped run", archive)
    page.get_by_text("ATE of odometry").wait_for()
    page.get_by_role("button", name="Play").click()
    wait_for(lambda: _time(page) > 1.0)
    page.get_by_role("button", name="Play").wait_for()
    assert abs(_time(page) - driven) < 0.11
    assert server.pages[0].drive.playback is None


def test_a_moment_that_is_shown_does_not_move_the_timeline_back(open_page: Open, server: Any) -> None:
    page = open_page()
    page.get_by_role("tab", name="Drive").click()
    page.get_by_role("button", name="Start").click()
    tab = server.pages[0].drive
    wait_for(lambda: tab.playback is not None and tab.playback.time > 2.0)
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Go on").wait_for()
    slider = vars(tab)["_slider"]
    shown = slider.value

    async def show_moment(event: Any) -> None:
        if event.client_id is not None:
            slider.value = shown

    slider.on_update(show_moment)
    field(page, "timeline").fill("1")
    wait_for(lambda: figure(page, "time").startswith("1.0 "), 20)


def test_closing_the_page_frees_its_simulation(open_page: Open, server: Any) -> None:
    page = open_page()
    page.get_by_role("tab", name="Drive").click()
    page.get_by_role("button", name="Start").click()
    page.get_by_text("driving").wait_for()
    served = server.pages[0]
    assert served.drive.playback is not None
    page.close()
    wait_for(lambda: not server.pages)
    assert served.worker.join(30)
    assert served.drive.playback is None
    assert not served.uploads.folder.exists()
    assert f"page {served.client.client_id}" not in {thread.name for thread in threading.enumerate()}
