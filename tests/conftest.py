"""Shared fixtures: the folder of real inputs, quiet numba."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

import lirs_envs  # noqa: F401  before mujoco, so that it renders without a screen

# Kernels compile inside the first example; a shared machine is slow at times.
settings.register_profile("local", deadline=None, max_examples=25)
settings.register_profile("ci", settings.get_profile("local"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") == "true" else "local")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real pictures, maps and logs; absent outside the developers' machines."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("shared/data is not beside the checkout")
    return folder


@pytest.fixture(scope="session")
def in_ci() -> bool:
    return os.environ.get("CI") == "true"
