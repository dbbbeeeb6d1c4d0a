"""Where a result comes from: versions, the package's own code, the machine."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import platform
from functools import cache
from pathlib import Path
from typing import Any

PACKAGES = ("lirs-wct", "mujoco", "gymnasium", "numpy", "scipy", "numba")
OWN = ("lirs_wct", "lirs_envs", "slam_baselines", "lirs_validation")


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide the result, and `code` (see there)."""
    return {"python": platform.python_version()} | _installed() | {"code": code()}


@cache
def _installed() -> dict[str, str]:
    return {p: importlib.metadata.version(p) for p in PACKAGES}


@cache
def code() -> str:
    """Return eight hex digits of our own code and robots: they distinguish two states of one version."""
    digest = hashlib.sha256()
    for package in OWN:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(path for path in Path(folder).rglob("*") if path.suffix in (".py", ".xml")):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:8]


def machine() -> dict[str, Any]:
    """Return what the run's times depend on."""
    return {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
