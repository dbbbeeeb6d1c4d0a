"""`lirs-wct doctor` says what is there, and how to get what is not."""

import importlib.metadata
from pathlib import Path
from typing import Any

import pytest

from lirs_validation.cli.commands import doctor


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures are drawn: each takes a process."""
    monkeypatch.setattr(doctor, "_draws", lambda backend: backend == "osmesa")


@pytest.mark.usefixtures("quick")
def test_a_whole_installation_is_well(wct: Any) -> None:
    code, out, _ = wct("doctor")
    assert code == 0
    assert f"mujoco │ {importlib.metadata.version('mujoco')}" in " ".join(out.replace("│", " │ ").split())
    assert "missing" not in out
    assert "apt-get install libegl1" in out
    assert "libosmesa6" not in out
    assert "[gui]" in out


@pytest.mark.usefixtures("quick")
def test_what_is_needed_and_missing_fails(wct: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version

    def version(package: str) -> str:
        if package in ("numba", "viser"):
            raise importlib.metadata.PackageNotFoundError
        return real(package)

    monkeypatch.setattr(importlib.metadata, "version", version)
    code, out, _ = wct("doctor")
    assert code == 3
    assert "missing" in out
    assert "pip install lirs-wct" in out
    assert "pip install 'lirs-wct[gui]'" in out


@pytest.mark.usefixtures("quick")
def test_caches_that_cannot_be_written_are_said(
    wct: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked / "numba"))
    monkeypatch.setenv("LIRS_WCT_CACHE", str(blocked / "worlds"))
    code, out, _ = wct("doctor")
    assert code == 0
    assert "set NUMBA_CACHE_DIR" in out
    assert "set LIRS_WCT_CACHE" in out
    monkeypatch.setenv("LIRS_WCT_CACHE", "")
    assert "switched off" in wct("doctor")[1]


@pytest.mark.render
def test_a_backend_that_draws_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor._draws("egl")
    assert not doctor._draws("nothing")
