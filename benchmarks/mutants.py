"""The tests under test: how many small mutations of the code their tests notice.

    python benchmarks/mutants.py [GROUP ...] [--module FILE ...] [--number N] [--seed K] [--survivors FILE]
                                 [--quick] [--json FILE]

A group (`metrics`, `poses`, `readers`) is a set of modules of which N mutants are drawn; `--module` takes all
mutants of one file (or N). Samples of different seeds share no mutant. A mutant is killed where a test of its
module fails, crashes or takes too long; the tests are those of the module's name or that import it, else of
its folder, without real files. The slow tests run where the fast ones pass. Everything runs in a copy of the
checkout, each mutant in a fork of a process with the libraries loaded. Kernels of a mutated module run as
plain Python: numba's cache would hold those of another mutant.
Every survivor is printed; `--survivors` runs those of an earlier `--json` again.
"""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.mutations import Mutation, mutations_of

ROOT = Path(__file__).resolve().parents[1]
READERS = (
    *(f"lirs_wct/formats/{name}.py" for name in ("elevation", "picture", "carmen_log", "laser_log")),
    *(f"lirs_wct/formats/{name}.py" for name in ("map_server", "drive_files", "world_json")),
    "lirs_wct/formats/meshes/reader.py",
    *(f"lirs_wct/sources/{name}.py" for name in ("laser_map", "picture", "frame")),
    *(f"lirs_wct/{name}.py" for name in ("geometry/walls", "meshing/solid")),
)
GROUPS = {
    "metrics": (63, ("lirs_validation/metrics/*.py",)),
    "poses": (48, tuple(f"lirs_wct/geometry/{name}.py" for name in ("pose", "grid"))),
    "readers": (85, READERS),
}
"""Mutants that are drawn, and the modules."""
COPIED = (
    *("lirs_wct", "envs", "slam_baselines", "lirs_validation", "lirs_extensions"),
    *("tests", "examples", "pyproject.toml"),
)
PRELOADED = (
    "numpy",
    "scipy.spatial",
    "scipy.optimize",
    "cv2",
    "numba",
    "pytest",
    "hypothesis.extra.numpy",
    "yaml",
)
"""Libraries that every mutant's process finds loaded."""
MARKS = ("not slow and not shared", "slow and not shared")
"""Tests that run one after the other, by their marks."""
PASSED = (0, 5)
"""Exit codes of pytest: passed, and no test of these marks."""
MEMORY = 8 << 30
"""Address space of a mutant's process: one that asks for more is killed."""
SLOWEST, SPARE = 5, 20.0
"""A mutant may take so many times as long as its tests do without it, and so many seconds more."""


@dataclass(frozen=True)
class Mutant:
    """A mutation of a module, a path in the checkout, whose source was as it is here."""

    module: str
    source: str
    mutation: Mutation

    @property
    def diff(self) -> str:
        """The changed lines."""
        return self.mutation.diff(self.source)


def modules_of(patterns: Sequence[str], root: Path) -> list[str]:
    """Return the modules of patterns, paths in the checkout; packages' `__init__` is left out."""
    found = sorted({path for pattern in patterns for path in root.glob(pattern)})
    return [str(path.relative_to(root)) for path in found if path.name != "__init__.py"]


def drawn(modules: Sequence[str], number: int | None, seed: int, root: Path) -> list[Mutant]:
    """Return a sample of the modules' mutants: slice `seed` (from 1) of one shuffled list of all."""
    sources = {module: (root / module).read_text(encoding="utf-8") for module in modules}
    found = [
        Mutant(name, text, mutation) for name, text in sources.items() for mutation in mutations_of(text)
    ]
    random.Random(0).shuffle(found)
    number = len(found) if number is None else number
    if (seed - 1) * number >= len(found):
        sys.exit(f"--seed {seed}: there are {len(found)} mutants, {number} a seed")
    return sorted(found[(seed - 1) * number : seed * number], key=lambda m: (m.module, m.mutation.start))


def tests_of(module: str, root: Path) -> list[str]:
    """Return the tests that have the module's name or import it, else the folder that mirrors its own."""
    path = Path(module)
    imported = ".".join(path.with_suffix("").parts).removeprefix("envs.") + " import"
    folder = Path("tests", *(part for part in path.parent.parts if part != "envs"))
    named = [
        test
        for place in (folder, "tests/properties", "tests/reference")
        for test in sorted((root / place).glob("test_*.py"))
        if path.stem in test.stem or imported in test.read_text(encoding="utf-8")
    ]
    found = [str(test.relative_to(root)) for test in named]
    while not found and not (root / folder).is_dir():
        folder = folder.parent
    return found or [str(folder)]


class Laboratory:
    """A copy of the checkout in which one module at a time is mutated."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._limits = folder, dict[tuple[Any, ...], float]()
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(ROOT / name, folder / name)

    def killed(self, mutant: Mutant) -> bool:
        """Whether the tests of a mutant's module notice it."""
        tests, jit = tests_of(mutant.module, self.folder), "@njit" not in mutant.source
        for mark in MARKS:
            limit = self._limit(tests, jit, mark)
            with self._mutated(mutant):
                if self._run(tests, jit, limit, mark) not in PASSED:
                    return True
        return False

    def _limit(self, tests: list[str], jit: bool, mark: str) -> float:
        """Return the seconds that a mutant gets; the tests must pass without one."""
        key = (*tests, jit, mark)
        if key not in self._limits:
            if self._run(tests, True, 600.0, mark, keep=True) not in PASSED:  # compiles modules and kernels
                sys.exit(f"{' '.join(tests)}: fail without a mutant")
            start = time.perf_counter()
            if self._run(tests, jit, 600.0, mark, keep=True) not in PASSED:
                sys.exit(f"{' '.join(tests)}: fail where kernels run as plain Python")
            self._limits[key] = SLOWEST * (time.perf_counter() - start) + SPARE
        return self._limits[key]

    @contextmanager
    def _mutated(self, mutant: Mutant) -> Iterator[None]:
        path = self.folder / mutant.module
        path.write_text(mutant.mutation.apply(mutant.source), encoding="utf-8")
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.cpython-*.pyc"):
            compiled.unlink()
        try:
            yield
        finally:
            path.write_text(mutant.source, encoding="utf-8")

    def _run(self, tests: list[str], jit: bool, limit: float, mark: str, keep: bool = False) -> int:
        """Run tests in a forked process; return pytest's exit code, -1 where it takes too long."""
        process = multiprocessing.get_context("fork").Process(
            target=_pytest, args=(self.folder, tests, jit, mark, keep)
        )
        process.start()
        try:
            process.join(limit)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid or 0, signal.SIGKILL)  # its children, too
            process.join()
        return -1 if process.exitcode is None else process.exitcode


def _pytest(folder: Path, tests: list[str], jit: bool, mark: str, keep: bool) -> None:
    """Run tests in the copy; `keep` what Python and numba compile."""
    os.setsid()
    os.chdir(folder)
    sys.path[:0] = [str(folder), str(folder / "envs")]
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])
    sys.dont_write_bytecode = not keep
    if not jit:
        os.environ["NUMBA_DISABLE_JIT"] = "1"
        importlib.import_module("numba").config.DISABLE_JIT = 1
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    quiet = os.open("pytest.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    hypothesis = importlib.import_module("hypothesis")
    # A failure is enough, it need not be small.
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
    hypothesis.settings.register_profile(
        "mutants", deadline=None, derandomize=True, database=None, phases=phases
    )
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-profile=mutants", "-m"]
    code = importlib.import_module("pytest").main([*options, mark, *tests])
    os._exit(int(code))


def figures(laboratory: Laboratory, mutants: Sequence[Mutant], console: Console) -> list[dict[str, Any]]:
    """Run every mutant; return its module, its diff and whether it was killed."""
    rows = []
    for mutant in mutants:
        killed = laboratory.killed(mutant)
        rows.append({"module": mutant.module, "killed": killed, "diff": mutant.diff})
        if not killed:
            console.print(f"survived: {mutant.module}\n{mutant.diff}\n", markup=False, highlight=False)
    return rows


def table(rows: Sequence[dict[str, Any]], title: str) -> Table:
    """Return the counts of every module."""
    shown = Table("module", "mutants", "killed", "survived", "share", title=title)
    modules = sorted({row["module"] for row in rows})
    for module in [*modules, "all"]:
        killed = [row["killed"] for row in rows if module in (row["module"], "all")]
        share = f"{sum(killed) / len(killed):.0%}"
        shown.add_row(module, str(len(killed)), str(sum(killed)), str(len(killed) - sum(killed)), share)
    return shown


def samples(given: argparse.Namespace, root: Path) -> Iterator[tuple[str, list[Mutant]]]:
    """Yield a name and the mutants of each group, of the modules, or of an earlier run's survivors."""
    if given.survivors:
        old = [row for row in json.loads(given.survivors.read_text(encoding="utf-8")) if not row["killed"]]
        yield (
            f"survivors of {given.survivors}",
            [
                mutant
                for mutant in drawn(sorted({row["module"] for row in old}), None, 1, root)
                if any((row["module"], row["diff"]) == (mutant.module, mutant.diff) for row in old)
            ],
        )
    elif given.module:
        modules = [str(path.resolve().relative_to(ROOT)) for path in given.module]
        yield "modules", drawn(modules, given.number, given.seed, root)
    else:
        for name in given.groups or GROUPS:
            number, patterns = GROUPS[name]
            number = given.number or (8 if given.quick else number)
            yield f"{name}, seed {given.seed}", drawn(modules_of(patterns, root), number, given.seed, root)


def main() -> None:
    """Draw mutants, run their tests, print what survived and the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)}; default: all")
    parser.add_argument(
        "--module", type=Path, action="append", help="a file of the packages; all its mutants"
    )
    parser.add_argument("--number", type=int, help="mutants of each group")
    parser.add_argument("--seed", type=int, default=1, help="which sample, from 1; no two share a mutant")
    parser.add_argument("--survivors", type=Path, help="run the survivors of an earlier --json again")
    parser.add_argument("--quick", action="store_true", help="8 mutants of each group")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if unknown := [name for name in given.groups if name not in GROUPS]:
        parser.error(f"unknown group {unknown[0]!r}; legal: {', '.join(GROUPS)}")
    if given.seed < 1 or (given.number or 1) < 1:
        parser.error("--seed and --number must be 1 or more")
    for path in given.module or []:
        if not path.is_file() or not path.resolve().is_relative_to(ROOT):
            parser.error(f"{path}: no module of this checkout")
    console, rows = Console(width=130), []
    for name in PRELOADED:
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as folder:
        laboratory = Laboratory(Path(folder))
        for title, mutants in samples(given, laboratory.folder):
            found = figures(laboratory, mutants, console)
            console.print(table(found, title))
            rows += found
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
