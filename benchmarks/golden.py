"""Golden results: what fixed commands and environments give, to show that a rearrangement changed nothing.

    python benchmarks/golden.py record FILE [--only PART,...] [--data FOLDER] [--quick]
    python benchmarks/golden.py compare FILE [--only PART,...] [--data FOLDER] [--quick]

Parts: builds, runs, options, originals, clouds, logs, score, collide, bench, envs. `record` stores the
SHA-256 of trajectories, maps, meshes, models, scans and tables, every value of the JSON files except
`EXCLUDED`, and each step of the environments. `compare` repeats the parts in FILE, or those named, and exits
1 with the first values that differ, by file. Digests hold on one machine: compilers round differently.
The script uses the command line and Gymnasium only; it also runs on version 1.0.0.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

TASKS = ("LIRS/Mapping-v2", "LIRS/Navigation-v1", "LIRS/Traverse-v1")
ROBOTS = ("husky", "jackal", "turtlebot3_burger")
GROUPS = ("scan", "sectors", "body", "odometry", "attitude", "seen_map", "height_map")
GOAL_GROUPS = ("goal", "goal_direction")
COUNT = 3
"""Robots of a vector."""
SEED = 11
MAX_NUMBERS = 6
"""Size of the largest array that is stored as numbers; a larger one is stored as digest."""
VARIANTS: dict[str, dict[str, Any]] = {
    "actors": {"world": "simple", "actors": 3, "odometry": "ekf", "noise": "datasheet", "sweep": True},
    "flight": {"task": TASKS[0], "world": "simple", "robot": "quadrotor"},
    "random": {"world": "advanced", "randomize": ["friction", "mass", "sensor", "start"], "control_hz": 20.0},
}
"""Options that the tasks and robots alone do not reach, tried with navigation unless they name a task."""


def environment_outcomes(steps: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and the steps of every environment, single and vector."""
    for task in TASKS:
        every = [*GROUPS, *(() if task == TASKS[0] else GOAL_GROUPS)]
        for robot in ROBOTS:
            name = f"{task.removeprefix('LIRS/')} {robot}"
            # A time limit ends episodes, so that resets are compared as well.
            for kind, options in (("default", {}), ("every group", {"observe": every, "time_limit": 3.0})):
                yield f"{name}, {kind}", single(task, steps, robot=robot, **options)
                yield f"{name}, {kind}, vector", vector(task, steps, robot=robot, **options)
    for name, options in VARIANTS.items():
        given: dict[str, Any] = {"task": TASKS[1]} | options
        title = f"{given['task'].removeprefix('LIRS/')} {name}"
        yield title, single(steps=steps, **given)
        yield f"{title}, vector", vector(steps=steps, autoreset_mode="SameStep", **given)


def single(task: str, steps: int, **options: Any) -> dict[str, Any]:
    """Return the steps of one environment, which is reset where an episode ends."""
    env = gym.make(f"lirs_envs:{task}", disable_env_checker=True, **options)
    return steps_of(env, steps, lambda step: actions(step, 1, *(env.action_space.shape or ()))[0])


def vector(task: str, steps: int, **options: Any) -> dict[str, Any]:
    """Return the steps of a vector of environments, which resets itself."""
    options |= {"num_envs": COUNT, "vectorization_mode": "vector_entry_point"}
    envs = gym.make_vec(f"lirs_envs:{task}", **options)
    return steps_of(envs, steps, lambda step: actions(step, *(envs.action_space.shape or ())))


def steps_of(env: Any, steps: int, action: Callable[[int], np.ndarray]) -> dict[str, Any]:
    """Return the outcomes of a number of steps."""
    outcomes = {"step 000": outcome(*env.reset(seed=SEED))}
    for step in range(1, steps + 1):
        observation, reward, terminated, truncated, info = env.step(action(step))
        ends = {"reward": reward, "terminated": terminated, "truncated": truncated}
        outcomes[f"step {step:03d}"] = outcome(observation, info, **ends)
        if not isinstance(env, gym.vector.VectorEnv) and (terminated or truncated):
            outcomes[f"step {step:03d}, reset"] = outcome(*env.reset())
    env.close()
    return outcomes


def actions(step: int, count: int, size: int) -> np.ndarray:
    """Return (count, size) actions of a step: mostly ahead, in curves that differ by robot."""
    phase = 0.13 * step + 1.7 * np.arange(count)[:, None] + 0.9 * np.arange(size)
    return np.clip(np.array([0.5] + [0.0] * (size - 1)) + 0.7 * np.sin(phase), -1.0, 1.0).astype(np.float32)


def outcome(observation: dict[str, Any], info: dict[str, Any], **ends: Any) -> dict[str, Any]:
    """Return what a step gave, the smallest values first."""
    found = {name: plain(value) for name, value in ends.items()}
    found |= {f"info.{name}": plain(value) for name, value in info.items()}
    return found | {f"observation.{name}": plain(value) for name, value in observation.items()}


def plain(value: Any) -> Any:
    """Return a value as JSON holds it; of a large array the type, shape and digest."""
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    array = np.asarray(value)
    if array.dtype == object:
        return [None if item is None else plain(item) for item in array.ravel()]
    if array.size <= MAX_NUMBERS:
        numbers = array.tolist()
        return str(numbers) if array.dtype.kind == "f" and not np.isfinite(array).all() else numbers
    digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:12]
    return f"{array.dtype}{list(array.shape)} {digest}"


ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
DIGESTED = (
    *(".tum", ".pgm", ".yaml", ".stl", ".dae", ".xml", ".sdf", ".world", ".config", ".hfield", ".npz"),
    *("scans.clf.gz", "imu.csv.gz", "commands.csv", "collisions.csv"),
)
MAPPERS = "hector,gmapping,cartographer"
ORIGINALS = "hector_original,gmapping_original,cartographer_original,slam_toolbox_original"
EXCLUDED = (
    "versions*",
    "machine*",
    "name",  # ends with a digest of the configuration, as the folder's name
    *("rtf.mean", "rtf.std", "rtf.min", "rtf.parts*", "rtf.physics*", "rtf.series*", "rtf.concurrent"),
    *("*wall_seconds", "*compile_seconds", "*cpu_seconds", "*read_seconds", "*map_seconds"),
    *("*peak_memory", "rtf.load_average", "mapper.ms_*", "*date", "*created"),
    *("config.threads", "config.bag", "rtf.mapper_in", "file_sizes*"),  # of 1.0.0
    *("config.build.pixel_size", "config.build.origin", "config.build.log_mapper"),
    *("config.particles", "config.reference_topic"),
)
"""Patterns of JSON keys that change from run to run: wall-clock times, RTF, machine, versions, dates.

Of paths, the data folder and the output folder are replaced by DATA and OUT.
"""
NEWER = (
    *("config.build.up", "config.time", "log.findings", "log.unfit"),
    *("step *.info.is_success", "step *.info._is_success"),
)
"""Patterns of keys that records of 1.0.0 lack: they may be absent before, as no other key may."""
COMMANDS = {
    "builds": (
        "build medium",
        "build DATA/height/mujoco__hfield.png --grayscale",
        "build DATA/height/gz-common__dem_squared.tif",
        "build DATA/height/pydelatin__fuji.png --grayscale",
        "build DEPOT",
        "build DATA/stl/unitree_mujoco__terrain.STL",
    ),
    "runs": (
        f"validate simple medium advanced --mapper {MAPPERS} --seconds SECONDS --seed SEEDS",
        f"validate DEPOT --mapper {MAPPERS} --seconds SECONDS --seed 1",
    ),
    "options": (
        "validate simple --robot jackal,turtlebot3_burger,quadrotor SHORT",
        "validate DEPOT --actors 3 --attitude none --driver frontier SHORT",
        "validate medium --window 0,0,16 --lidar lds01 --rays mujoco SHORT",
        "validate medium --terrain mesh SHORT",
    ),
    "originals": (
        f"validate medium --mapper {ORIGINALS} SHORT",
        f"validate DEPOT --mapper {ORIGINALS} SHORT",
    ),
    "clouds": ("validate medium DEPOT --mapper kiss-icp --lidar vlp16 SHORT",),
    "logs": (
        *(f"map DATA/logs/csail/mit-csail.clf.gz --mapper {mapper}" for mapper in MAPPERS.split(",")),
        "map DATA/logs/orebro/orebro.clf.gz --mapper hector "
        "--reference DATA/logs/orebro/reference_poses.tum.gz",
    ),
    "score": (
        "validate DEPOT --mapper hector SHORT",
        "score RUN --trajectory RUN/odometry.tum --map RUN/map.yaml",
    ),
    "collide": ("collide advanced --robot husky,jackal SHORT",),
    "bench": tuple(
        f"bench straight go_to_goal --set generated --split validation --task {task}"
        for task in ("navigation", "traverse")
    ),
}
"""Commands of each part; RUN stands for the folder of the part's first run, `bench` is shorter if quick."""
SHOWN = 3
"""Differing values that are printed for each file."""
PARTS = (*COMMANDS, "envs")
ABSENT = "absent"
Outcomes = dict[str, Any]


def commands(part: str, data: Path, quick: bool) -> list[list[str]]:
    """Return the arguments of every command of a part."""
    values = {"DATA": str(data), "DEPOT": str(next((data / "maps").glob("navigation2/*depot*.yaml")))}
    values |= {"SECONDS": "10" if quick else "30", "SEEDS": "1" if quick else "1-2"}
    values |= {"SHORT": f"--seconds {5 if quick else 10}"}
    lines = COMMANDS[part][: 1 if quick and part == "bench" else None]
    for name, value in values.items():
        lines = tuple(line.replace(name, value) for line in lines)
    return [line.split() for line in lines]


def outcomes_of_part(part: str, data: Path, quick: bool) -> Outcomes:
    """Run a part; return file or environment -> digest, values or steps."""
    if part == "envs":
        return {f"envs/{name}": steps for name, steps in environment_outcomes(40 if quick else 100)}
    found: Outcomes = {}
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder, part)
        for number, command in enumerate(commands(part, data, quick)):
            out = base / f"{number:02d}"
            run_command(command, out)
            for file in sorted(out.rglob("*")):
                name = stable_name(file, Path(folder))
                outcome = read_outcome(file, {str(data): "DATA", folder: "OUT"})
                if name in found:
                    sys.exit(f"{name}: two runs of one name; give each a command of its own")
                if outcome is not None:
                    found[name] = outcome
    return found


def run_command(command: list[str], out: Path) -> None:
    """Run a command that writes into a folder, and exit where it fails."""
    out.mkdir(parents=True)
    run = next((file.parent for file in (out.parent / "00").glob("*/record.json")), None)
    arguments = [argument.replace("RUN", str(run)) for argument in command]
    target = out / "score.json" if command[0] == "score" else out
    program = Path(sys.executable).with_name("lirs-wct")
    done = subprocess.run([program, *arguments, "-o", target], capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):  # 3: a run that failed, which is a result as well
        sys.exit(f"lirs-wct {' '.join(command)}: exit {done.returncode}\n{done.stderr}")


def read_outcome(file: Path, stands_for: dict[str, str]) -> Any:
    """Return the digest of a file, the values of a JSON file, or None if the file is not compared."""
    if file.suffix == ".json" and file.name != "sweep.json":
        text = file.read_text(encoding="utf-8")
        for folder, name in stands_for.items():
            text = text.replace(folder, name)
        return without_excluded(json.loads(text, parse_constant=str))
    if not file.is_file() or not file.name.endswith(DIGESTED):
        return None
    # A gzip header holds the time of writing.
    content = gzip.decompress(file.read_bytes()) if file.suffix == ".gz" else file.read_bytes()
    return hashlib.sha256(content).hexdigest()


def without_excluded(value: Any, path: str = "") -> Any:
    """Return a JSON value without the keys in `EXCLUDED`."""
    if isinstance(value, list):
        return [without_excluded(item, path) for item in value]
    if not isinstance(value, dict):
        return value
    paths = {key: f"{path}.{key}".lstrip(".") for key in value}
    kept = {key: p for key, p in paths.items() if not any(fnmatch(p, pattern) for pattern in EXCLUDED)}
    return {key: without_excluded(value[key], p) for key, p in kept.items()}


def stable_name(file: Path, folder: Path) -> str:
    """Return the file's path without the fingerprint of the configuration at the end of a run's folder."""
    parts = file.relative_to(folder).parts
    return "/".join(part[:-9] if part[-9:-8] == "-" and "." not in part[-8:] else part for part in parts)


def differences(before: Any, now: Any, path: str = "") -> Iterator[str]:
    """Yield the path of every differing value, with both values."""
    if isinstance(before, list) and isinstance(now, list):
        before, now = ({f"[{i}]": item for i, item in enumerate(items)} for items in (before, now))
    if isinstance(before, dict) and isinstance(now, dict):
        for key in before | now:
            place = f"{path}.{key}".lstrip(".")
            if key in before or not any(fnmatch(place, pattern) for pattern in NEWER):
                yield from differences(before.get(key, ABSENT), now.get(key, ABSENT), place)
    elif before != now:
        yield f"{path}: {short_text(before)} -> {short_text(now)}"


def short_text(value: Any) -> str:
    """Return a value as text of at most 60 characters."""
    text = value[:12] if isinstance(value, str) and len(value) == 64 else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def compare(before: Outcomes, now: Outcomes) -> int:
    """Print the first differing values by file; return the number of files that differ."""
    changed = 0
    for name in sorted(before.keys() | now.keys()):
        sides = (without_excluded(side.get(name, ABSENT)) for side in (before, now))
        found = list(differences(*sides))
        if found:
            more = f" (and {len(found) - SHOWN} more)" if len(found) > SHOWN else ""
            print(f"differs: {name}: {'; '.join(line.lstrip(': ') for line in found[:SHOWN])}{more}")
            changed += 1
    print(f"{changed} of {len(before)} differ")
    return changed


def read_parts(text: str) -> list[str]:
    """Return the named parts in their order."""
    for name in text.split(","):
        if name not in PARTS:
            raise argparse.ArgumentTypeError(f"no part {name!r}; parts: {', '.join(PARTS)}")
    return [part for part in PARTS if part in text.split(",")]


def main() -> None:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", type=read_parts, metavar="PART,...", help=", ".join(PARTS))
    parser.add_argument("--data", type=Path, default=DATA, help="folder with height/, maps/, logs/ and stl/")
    parser.add_argument("--quick", action="store_true", help="one seed, shorter drives")
    given = parser.parse_args()
    stored: dict[str, Any] = {"quick": given.quick, "parts": {}}
    if given.action == "compare":
        stored = json.loads(given.file.read_text(encoding="utf-8"))
        if stored["quick"] != given.quick:
            parser.error(f"{given.file}: recorded {'with' if stored['quick'] else 'without'} --quick")
    parts = given.only or (list(stored["parts"]) if given.action == "compare" else list(PARTS))
    if given.action == "compare" and set(parts) - stored["parts"].keys():
        parser.error(f"{given.file}: recorded only {', '.join(stored['parts'])}")
    now = {part: outcomes_of_part(part, given.data, given.quick) for part in parts}
    if given.action == "record":
        text = json.dumps(stored | {"parts": now})
        given.file.write_text(text + "\n", encoding="utf-8")
        print(f"{given.file}: {sum(map(len, now.values()))} outcomes")
        return
    before = {name: value for part in parts for name, value in stored["parts"][part].items()}
    # Through JSON, as the stored outcomes went.
    after = json.loads(json.dumps({name: value for part in now.values() for name, value in part.items()}))
    sys.exit(bool(compare(before, after)))


if __name__ == "__main__":
    main()
