"""Golden results: digests of what fixed commands write, to show that a rearrangement changed nothing.

    python benchmarks/golden.py record FILE [--data FOLDER] [--quick]
    python benchmarks/golden.py compare FILE [--data FOLDER] [--quick]

`record` runs three mappers x three worlds x two seeds for 30 s, a laser map, a log and the build of six
sources, and writes the SHA-256 of every `estimate.tum`, `map.pgm`, STL, DAE, MJCF and SDF. `compare` runs
them again and exits 1, naming the files whose bytes differ. Digests hold on one machine: compilers round
differently on another.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
KEPT = ("estimate.tum", "odometry.tum", "map.pgm", ".stl", ".dae", ".xml", ".sdf", ".world")
MAPPERS = "hector,gmapping,cartographer"


def commands(data: Path, quick: bool) -> list[list[str]]:
    """Return the arguments of every command of the golden set."""
    seconds, seeds = ("10", "1") if quick else ("30", "1-2")
    maps, height = data / "maps", data / "height"
    depot = next(maps.glob("navigation2/*depot*.yaml"))
    builds = [
        ["medium"],
        [str(height / "mujoco__hfield.png"), "--grayscale"],
        [str(height / "gz-common__dem_squared.tif")],
        [str(height / "pydelatin__fuji.png"), "--grayscale"],
        [str(depot)],
        [str(data / "stl" / "unitree_mujoco__terrain.STL")],
    ]
    run = ["--mapper", MAPPERS, "--seconds", seconds]
    return [
        ["validate", "simple", "medium", "advanced", *run, "--seeds", seeds],
        ["validate", str(depot), *run, "--seeds", "1"],
        *(
            ["map", str(data / "logs" / "csail" / "mit-csail.clf.gz"), "--mapper", mapper]
            for mapper in MAPPERS.split(",")
        ),
        *(["build", *source] for source in builds),
    ]


def digests(data: Path, quick: bool) -> dict[str, str]:
    """Run every command in a folder of its own; return file -> SHA-256."""
    found: dict[str, str] = {}
    program = Path(sys.executable).with_name("lirs-wct")
    with tempfile.TemporaryDirectory() as folder:
        for number, command in enumerate(commands(data, quick)):
            out = Path(folder, f"{number:02d}")
            done = subprocess.run([program, *command, "-o", out], capture_output=True, text=True, check=False)
            if done.returncode not in (0, 3):  # 3: a run that failed, which is a result as well
                sys.exit(f"lirs-wct {' '.join(command)}: exit {done.returncode}\n{done.stderr}")
            for file in sorted(out.rglob("*")):
                if file.is_file() and file.name.endswith(KEPT):
                    found[stable_name(file, Path(folder))] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


def stable_name(file: Path, folder: Path) -> str:
    """Return the file's path without the fingerprint of the configuration at the end of a run's folder."""
    parts = file.relative_to(folder).parts
    return "/".join(part[:-9] if part[-9:-8] == "-" and "." not in part[-8:] else part for part in parts)


def main() -> None:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--data", type=Path, default=DATA, help="folder with height/, maps/, logs/ and stl/")
    parser.add_argument("--quick", action="store_true", help="one seed, 10 s")
    given = parser.parse_args()
    now = digests(given.data, given.quick)
    if given.action == "record":
        given.file.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
        print(f"{given.file}: {len(now)} digests")
        return
    before = json.loads(given.file.read_text(encoding="utf-8"))
    changed = sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))
    print(*(f"differs: {name}" for name in changed), f"{len(changed)} of {len(before)} differ", sep="\n")
    sys.exit(bool(changed))


if __name__ == "__main__":
    main()
