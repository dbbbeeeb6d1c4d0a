"""The page in a browser: clicks drive, Space pauses, refused files, names, narrow windows, dark mode."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.lirs_validation.gui.conftest import PATIENCE
from tests.lirs_validation.gui.pages import field, figure, upload, wait_for

pytestmark = pytest.mark.slow
Open = Callable[..., Any]
UNNAMED = """() => [...document.querySelectorAll('input, button, img, [role=slider], .lirs-stick')]
  .filter(e => e.offsetParent && e.type !== 'file' && !(e.ariaLabel || e.alt || e.textContent.trim()
    || (e.labels && e.labels.length))).map(e => e.outerHTML.slice(0, 200))"""
OUTSIDE = """() => [...document.querySelectorAll('button, input, label, img, code, td')].filter(e => {
    const box = e.getBoundingClientRect();
    return e.offsetParent && box.width && (box.left < 0 || box.right > innerWidth + 1);
  }).map(e => e.outerHTML.slice(0, 200))"""

WATCH = """() => {
  window.uncovered = [];
  const look = () => {
    const field = [...document.querySelectorAll('input')].find(e => e.value.startsWith('ws:'));
    const box = field?.getBoundingClientRect();
    if (box?.height) window.uncovered.push(document.elementFromPoint(box.left + 9, box.top + 9) === field);
    requestAnimationFrame(look);
  };
  look();
}"""
TINY = """() => [...document.querySelectorAll('button, input, [role=tab], [role=button]')].filter(e => {
    const box = e.getBoundingClientRect();
    const least = e.type === 'checkbox' ? 28 : 44;
    return e.offsetParent && e.type !== 'file' && Math.min(box.width, box.height) < least;
  }).map(e => e.outerHTML.slice(0, 200))"""


def _clicked_drive(page: Any) -> None:
    """Click start and goal on the ground of the world "simple"."""
    page.get_by_role("tab", name="Drive").click()
    page.get_by_text("Click the ground twice").wait_for()
    width, height = page.viewport_size["width"], page.viewport_size["height"]
    page.mouse.click(0.25 * width, 0.62 * height)
    page.get_by_text("Now click the goal").wait_for()
    page.mouse.click(0.45 * width, 0.62 * height)
    page.get_by_text("driving").wait_for()


def test_two_clicks_drive_and_the_end_says_what_is_next(open_page: Open, server: Any) -> None:
    page = open_page()
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    server.pages[0].drive._speed.value = "1 x real time"  # still driving when Space is pressed
    _clicked_drive(page)
    drive = server.pages[0].drive.playback
    page.get_by_text("Verdict so far").wait_for()
    page.locator("canvas").first.focus()
    page.keyboard.press("Space")
    page.get_by_role("button", name="Go on").wait_for()
    wait_for(lambda: not server.pages[0].drive.running)
    stood = drive.time
    page.wait_for_timeout(500)
    assert drive.time - stood < 0.1
    page.keyboard.press("Space")
    page.get_by_role("button", name="Pause").wait_for()
    page.get_by_text("The drive has ended.").wait_for()
    assert drive.time > stood
    assert "the last waypoint is reached" in figure(page, "status")
    page.get_by_text("hector on husky works on simple").wait_for()
    assert field(page, "timeline").input_value() == f"{round(drive.time, 1):g}"
    assert "%" in figure(page, "time")
    start, goal = drive.config.build.start, drive.config.driver
    assert drive.moment(0).truth[0, :2] == pytest.approx((start.x, start.y), abs=0.02)
    page.get_by_role("button", name="Copy command").click()
    command = page.evaluate("navigator.clipboard.readText()")
    words = shlex.split(command)
    assert words[:3] == ["lirs-wct", "validate", "simple"]
    assert words[words.index("--driver") + 1] == goal
    assert words[words.index("--start") + 1] == f"{start.x:g},{start.y:g},{start.yaw:g}"


def test_a_place_where_no_robot_can_stand_is_named(open_page: Open, server: Any) -> None:
    page = open_page()
    served = server.pages[0]
    served.drive.click((-7.0, -13.0))
    served.drive.click((24.9, 24.9))
    page.get_by_text("is no place for husky").wait_for()
    page.get_by_role("tab", name="Drive").click()
    page.get_by_text("Click the ground twice").wait_for()


def test_a_refused_file_changes_nothing(open_page: Open, server: Any, picture: Path, tmp_path: Path) -> None:
    page = open_page()
    upload(page, "Open files", picture)
    page.get_by_text("hill (terrain)").wait_for()
    wait_for(lambda: field(page, "source").input_value() == "hill.png")
    shown = server.pages[0].world.shown
    broken = tmp_path / "broken.png"
    broken.write_bytes(picture.read_bytes()[:200])
    upload(page, "Open files", broken)
    page.get_by_text("broken.png: ").wait_for()
    assert page.get_by_text("hill (terrain)").is_visible()
    assert field(page, "source").input_value() == "hill.png"
    assert server.pages[0].world.shown is shown
    page.get_by_role("button", name="Build").click()
    page.get_by_text("watertight").wait_for()
    assert "broken.png" not in server.pages[0].world._sources


@pytest.mark.parametrize("width", [390, 900, 1300])
def test_controls_have_names_and_stay_inside(open_page: Open, server: Any, width: int) -> None:
    page = open_page(width, 844, touch=width == 390)
    for tab in ("World", "Drive", "Replay"):
        page.get_by_role("tab", name=tab).click()
        if tab == "Drive":
            field(page, "drive by hand").click()
            page.locator(".lirs-stick").wait_for()
            page.get_by_text("More options").click()
            field(page, "walkers").wait_for()
        wait_for(lambda: page.evaluate(UNNAMED) == [])
        assert page.evaluate(OUTSIDE) == []
    page.get_by_role("tab", name="Drive").click()
    field(page, "drive by hand").click()
    for place in ((-7.0, -13.0), (0.0, -12.5)):
        server.pages[-1].drive.click(place)
    page.get_by_text("The drive has ended.").wait_for()
    wait_for(lambda: page.evaluate(UNNAMED) == [])
    assert page.evaluate(OUTSIDE) == []
    if width == 390:
        assert page.evaluate(TINY) == []
        page.get_by_text("LIRS-WCT", exact=True).click()
        page.get_by_role("tab", name="Drive").wait_for(state="hidden")
        assert page.get_by_text("Verdict", exact=True).is_visible()
        page.get_by_text("LIRS-WCT", exact=True).click()
        page.get_by_text("Map", exact=True).click()
    page.get_by_alt_text("Map of the drive").wait_for()
    wait_for(lambda: page.get_by_alt_text("Map of the drive").bounding_box()["width"] > 200)
    middle = page.evaluate("document.elementFromPoint(innerWidth * 0.45, innerHeight * 0.5).tagName")
    assert middle == "CANVAS"  # the robot in the middle is not covered


def test_title_icon_loading_and_dark_mode(browser: Any, server: Any) -> None:
    page = browser.new_page(color_scheme="dark")
    page.set_default_timeout(PATIENCE)
    page.add_init_script(f"({WATCH})()")
    response = page.goto(server.address)
    assert 'class="lirs-loading" role="status"' in response.text()
    page.get_by_text("50 x 50 m").first.wait_for()
    page.locator(".lirs-loading").wait_for(state="hidden")
    uncovered = page.evaluate("window.uncovered")
    assert uncovered  # the viewer's own settings were there
    assert True not in uncovered  # below our loading state
    assert page.title() == "LIRS-WCT"
    icons = page.locator("link[rel=icon]")
    assert icons.count() == 1
    assert "0072B2" in icons.get_attribute("href")
    assert page.locator("html").get_attribute("data-mantine-color-scheme") == "dark"
    page.close()
