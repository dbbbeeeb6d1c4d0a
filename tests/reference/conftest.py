import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def gazebo() -> Callable[..., str]:
    """Run a program on Gazebo's libraries (sdfchk, meshchk, physchk) and return what it says."""
    folder = os.environ.get("GAZEBO_CHECK")
    if not folder:
        pytest.skip("GAZEBO_CHECK does not name the folder of sdfchk, meshchk, physchk")

    def run(program: str, *arguments: object, **env: object) -> str:
        done = subprocess.run(
            [str(Path(folder) / program), *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, **{k: str(v) for k, v in env.items()}},
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout + done.stderr

    return run
