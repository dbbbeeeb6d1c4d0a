"""The core works without the extensions, and its mappers name only those that exist."""

import subprocess
import sys
from pathlib import Path
from pkgutil import resolve_name

import pytest

from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS

ALONE = """
import sys
sys.modules["lirs_extensions"] = None  # an import of it fails
from lirs_validation.cli.app import main
main()
"""


@pytest.mark.slow
def test_the_core_runs_without_extensions(tmp_path: Path) -> None:
    run = ["validate", "simple", "--mapper", "hector,gmapping,cartographer", "--seconds", "2", "-o", "out"]
    compare = ["compare", "out:mapper=hector", "out:mapper=gmapping", "--across", "mapper"]
    for command in (run, ["report", "out"], compare):
        subprocess.run([sys.executable, "-c", ALONE, *command], cwd=tmp_path, check=True)
    assert len(list(tmp_path.glob("out/*/record.json"))) == 3
    assert (tmp_path / "report.html").exists()


def test_mappers_name_what_exists() -> None:
    for method in (MAPPERS | ALL_CLOUD_MAPPERS).values():
        for name in (method.config, method.factory):
            assert callable(resolve_name(f"{method.module}:{name}")), method
