"""`lirs-wct doctor` says what is there, and how to get what is not."""

import importlib.metadata
from pathlib import Path
from typing import Any

import pytest

from lirs_validation.cli.commands import installation as doctor


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
    assert "pip install ." in out
    assert "pip install '.[gui]'" in out


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


def test_a_machine_of_a_ray_cluster_needs_mode_and_token(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(doctor, "_version", lambda package: "2.60")
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(tmp_path / "token"))
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    (check,) = doctor._ray_token()
    assert "RAY_AUTH_MODE=(not set), no token" in check.found
    assert "export RAY_AUTH_MODE=token" in check.mend
    assert "ray get-auth-token" in check.mend
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    (tmp_path / "token").write_text("secret")
    (check,) = doctor._ray_token()
    assert (check.found, check.mend) == ("RAY_AUTH_MODE=token, a token", "")
    monkeypatch.setattr(doctor, "_version", lambda package: None)
    assert not list(doctor._ray_token())


@pytest.mark.render
def test_a_backend_that_draws_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor._draws("egl")
    assert not doctor._draws("nothing")
