"""The command `doctor`: checks of the installation, with repair commands."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from click.exceptions import Exit
from rich.markup import escape
from rich.table import Table

from lirs_validation.cli.progress import RUN_FAILED, out

REQUIRED = (
    "mujoco",
    "gymnasium",
    "numpy",
    "scipy",
    "numba",
    "trimesh",
    "opencv-python-headless",
    "matplotlib",
    "rosbags",
)
EXTRAS = {
    "gui": ("viser", "pillow"),
    "mesh": ("coacd", "embreex"),
    "live": ("cyclonedds", "eclipse-zenoh"),
    "rl": ("stable-baselines3",),
    "dist": ("ray",),
    "search": ("cma",),
    "notebooks": ("ipykernel", "nbclient"),
    "usd": ("usd-core",),
}
"""Packages of each extra."""
BACKENDS = {
    "egl": "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0",
    "osmesa": "apt-get install libosmesa6",
    "glfw": "needs a screen (DISPLAY)",
}
"""OpenGL backends of MuJoCo, and the packages that install them."""
_RENDER = (
    'import mujoco as m; model = m.MjModel.from_xml_string(\'<mujoco><worldbody><geom size=".1"/>'
    "</worldbody></mujoco>'); r = m.Renderer(model, 16, 16); d = m.MjData(model); m.mj_forward(model, d); "
    "r.update_scene(d); assert r.render().any(); r.close()"
)
PATIENCE = 60
"""Seconds that a backend may take for a picture."""


@dataclass(frozen=True)
class InstallationCheck:
    """One thing that was looked at.

    Attributes:
        name: of the thing.
        found: finding.
        mend: how to get it; empty = it is there.
        needed: whether nothing works without it.
    """

    name: str
    found: str
    mend: str = ""
    needed: bool = False


def doctor() -> None:
    """Check the installation (versions, OpenGL, caches, extras) and print repair commands.

    Examples:
    lirs-wct doctor
    """
    checks = list(_checks())
    table = Table(show_header=True, title="lirs-wct doctor", title_justify="left")
    for heading in ("", "what", "found", "how to mend it"):
        table.add_column(heading)
    for check in checks:
        mark = "[green]ok" if not check.mend else "[red]missing" if check.needed else "[yellow]optional"
        table.add_row(mark, escape(check.name), escape(check.found), escape(check.mend))
    out.print(table)
    if any(check.mend and check.needed for check in checks):
        raise Exit(RUN_FAILED)


def _checks() -> Iterator[InstallationCheck]:
    yield InstallationCheck("python", f"{platform.python_version()}, {sys.executable}")
    for name in ("lirs-wct", *REQUIRED):
        version = _version(name)
        yield InstallationCheck(name, version or "-", "" if version else "pip install .", needed=True)
    yield from _opengl()
    yield _numba_cache()
    yield _world_cache()
    yield from _ray_token()
    for extra, packages in EXTRAS.items():
        found = {name: _version(name) for name in packages}
        text = ", ".join(f"{name} {version or '-'}" for name, version in found.items())
        yield InstallationCheck(
            f"[{extra}]", text, "" if all(found.values()) else f"pip install '.[{extra}]'"
        )


def _ray_token() -> Iterator[InstallationCheck]:
    """Check the token by which machines of a Ray cluster know each other."""
    if _version("ray") is None:
        return
    mode = os.environ.get("RAY_AUTH_MODE", "")
    path = Path(os.environ.get("RAY_AUTH_TOKEN_PATH") or Path.home() / ".ray" / "auth_token")
    given = bool(os.environ.get("RAY_AUTH_TOKEN")) or path.is_file()
    found = f"RAY_AUTH_MODE={mode or '(not set)'}, {'a token' if given else 'no token'}"
    missing = [] if mode == "token" else ["export RAY_AUTH_MODE=token"]
    missing += [] if given else ["ray get-auth-token --generate, the same file on each machine"]
    yield InstallationCheck("Ray cluster", found, "; ".join(missing))


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _opengl() -> Iterator[InstallationCheck]:
    """Draw a picture with each backend in its own process; MuJoCo chooses one per process.

    Only pictures of the simulation need one.
    """
    for backend, mend in BACKENDS.items():
        works = _draws(backend)
        yield InstallationCheck(
            f"OpenGL by {backend}", "draws" if works else "no picture", "" if works else mend
        )


def _draws(backend: str) -> bool:
    environment = os.environ | {"MUJOCO_GL": backend}
    try:
        drawn = subprocess.run(
            [sys.executable, "-c", _RENDER],
            env=environment,
            capture_output=True,
            timeout=PATIENCE,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return drawn.returncode == 0


def _numba_cache() -> InstallationCheck:
    """Check the cache of compiled kernels; without it, each start compiles for a minute."""
    import lirs_wct

    given = os.environ.get("NUMBA_CACHE_DIR")
    package = Path(lirs_wct.__file__).parent / "__pycache__"
    places = [Path(given)] if given else [package, Path.home() / ".cache" / "numba"]
    usable = next((place for place in places if _writable(place)), None)
    if usable is None:
        mend = "set NUMBA_CACHE_DIR to a folder that can be written"
        return InstallationCheck("numba cache", f"{places[0]}: cannot be written", mend)
    return InstallationCheck("numba cache", str(usable))


def _world_cache() -> InstallationCheck:
    from lirs_envs.episodes.world_cache import cache_folder

    folder = cache_folder()
    if folder is None:
        return InstallationCheck("world cache", "switched off (LIRS_WCT_CACHE is empty)")
    if _writable(folder):
        return InstallationCheck("world cache", str(folder))
    return InstallationCheck(
        "world cache", f"{folder}: cannot be written", "set LIRS_WCT_CACHE to a folder that can be"
    )


def _writable(folder: Path) -> bool:
    """Whether a folder, or its nearest existing parent, is writable."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=there):
            return True
    except OSError:
        return False
