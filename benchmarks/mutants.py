"""The tests under test: how many small mutations of the code their tests notice.

    python benchmarks/mutants.py [GROUP|MODULE ...] [--number N] [--seed K] [--quick]

Of a group (`metrics`, `poses`, `readers`) N mutants are drawn, of a module all are taken. A mutant is killed
where a test of its module fails, crashes or takes too long; the tests are those of the module's name or that
import it, else of its folder, the slow ones last. Everything runs in a copy of the checkout, each mutant in a
fork of a process with the libraries loaded; kernels of a mutated module run as plain Python. Every survivor
is printed. Samples of different seeds share no mutant.
"""

from __future__ import annotations

import ast
import copy
import difflib
import importlib
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

from benchmarks.steps import arguments, print_rows

ORDER: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
}


def both_ways(*pairs: tuple[Any, Any]) -> dict[Any, Any]:
    """Return a table in which each of a pair stands for the other."""
    return dict(pairs) | {b: a for a, b in pairs}


NEGATIONS = both_ways((ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn))
OPERATORS = both_ways(
    (ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.BitAnd, ast.BitOr), (ast.LShift, ast.RShift)
) | dict.fromkeys((ast.FloorDiv, ast.Mod, ast.Pow), ast.Mult)
TWIN = both_ways(
    *(("min", "max"), ("minimum", "maximum"), ("nanmin", "nanmax"), ("argmin", "argmax")),
    *(("floor", "ceil"), ("any", "all"), ("sin", "cos"), ("zeros", "ones"), ("radians", "degrees")),
)
GUARDS = ("strict", "stacklevel")
"""Arguments without a say in what comes out."""
OPERATIONS = (ast.BinOp, ast.BoolOp, ast.Compare, ast.UnaryOp)
Node = ast.expr | ast.stmt


@dataclass(frozen=True)
class Mutation:
    """A text in place of the bytes of a node in the source (UTF-8), from `start` to before `end`."""

    start: int
    end: int
    text: str

    def apply(self, source: str) -> str:
        """Return the mutated source."""
        raw = source.encode()
        return (raw[: self.start] + self.text.encode() + raw[self.end :]).decode()

    def diff(self, source: str) -> str:
        """Return the changed lines, `-` before and `+` after, each with its number in the source."""
        before, after = source.splitlines(), self.apply(source).splitlines()
        row = source.encode()[: self.start].count(b"\n") + 1
        changed = list(difflib.unified_diff(before, after, n=0, lineterm=""))
        return "\n".join(f"{row:>5} {line}" for line in changed[3:])


def mutations_of(source: str) -> list[Mutation]:
    """Return every mutation of a module, in the order of its text."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = set()
    for node, in_function in _nodes(ast.parse(source), False):
        for old, new in _replacements(node, in_function):
            start = starts[old.lineno - 1] + old.col_offset
            end = starts[(old.end_lineno or old.lineno) - 1] + (old.end_col_offset or 0)
            text = ast.unparse(new)
            found.add(Mutation(start, end, f"({text})" if isinstance(new, OPERATIONS) else text))
    return sorted(found, key=lambda m: (m.start, m.end, m.text))


def _nodes(node: ast.AST, in_function: bool) -> Iterator[tuple[Node, bool]]:
    """Walk the code of a tree; texts, annotations, decorators and what only warns or guards are left out."""
    in_function = in_function or isinstance(node, ast.FunctionDef | ast.Lambda)
    if isinstance(node, ast.expr | ast.stmt):
        yield node, in_function
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            text = isinstance(child, ast.JoinedStr) or (
                isinstance(child, ast.keyword) and child.arg in GUARDS
            )
            if isinstance(child, ast.AST) and not text:
                yield from _nodes(child, in_function)


def _replacements(node: Node, in_function: bool) -> Iterator[tuple[Node, ast.AST]]:
    """Yield a node or a part of it, and what may stand in its place."""
    match node:
        case ast.Compare(ops=ops):
            for k, op in enumerate(ops):
                for other in ORDER.get(type(op)) or (NEGATIONS[type(op)],):
                    yield node, _with(node, ops=[*ops[:k], other(), *ops[k + 1 :]])
        case ast.BinOp(op=ast.BitOr()) if not in_function:
            return  # a union of types
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in OPERATORS:
            yield node, _with(node, op=OPERATORS[type(op)]())
        case ast.BoolOp(op=op):
            yield node, _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.UnaryOp(operand=operand):
            yield node, operand
        case ast.Constant(value=value) if isinstance(value, bool | int | float):
            others = [not value] if isinstance(value, bool) else [value - 1, value + 1]
            if isinstance(value, float):
                others = [value * 2, value / 2] if value else [1.0]
            yield from ((node, ast.Constant(other)) for other in others)
        case ast.If(test=test) | ast.IfExp(test=test) if not isinstance(test, ast.Compare | ast.UnaryOp):
            yield test, ast.UnaryOp(ast.Not(), test)
        case ast.Break():
            yield node, ast.Continue()
        case ast.Continue():
            yield node, ast.Break()
        case ast.Call(func=ast.Name(id="range"), args=args):
            last = min(len(args) - 1, 1)
            yield args[last], ast.BinOp(args[last], ast.Sub(), ast.Constant(1))
        case ast.Name(id=name) if name in TWIN:
            yield node, ast.Name(TWIN[name])
        case ast.Attribute(attr=name) if name in TWIN:
            yield node, _with(node, attr=TWIN[name])


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


ROOT = Path(__file__).resolve().parents[1]
READERS = (
    *(f"lirs_wct/formats/{name}.py" for name in ("elevation", "picture", "carmen_log", "laser_log")),
    *(f"lirs_wct/formats/{name}.py" for name in ("map_server", "drive_files")),
    "lirs_wct/formats/meshes/reader.py",
    *(f"lirs_wct/sources/{name}.py" for name in ("laser_map", "picture")),
    *(f"lirs_wct/{name}.py" for name in ("ground", "meshing/solid", "meshing/walls")),
)
GROUPS = {
    "metrics": (63, ("lirs_validation/metrics/*.py",)),
    "poses": (48, tuple(f"lirs_wct/geometry/{name}.py" for name in ("pose", "grid"))),
    "readers": (85, tuple(f"lirs_wct/{name}.py" for name in READERS)),
}
"""Mutants that are drawn, and the modules."""
COPIED = (
    *("lirs_wct", "envs", "slam_baselines", "lirs_validation", "lirs_extensions"),
    *("tests", "examples", "pyproject.toml"),
)
PRELOADED = (
    *("numpy", "scipy.spatial", "scipy.optimize", "cv2", "numba", "pytest", "hypothesis.extra.numpy", "yaml"),
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


def draw(patterns: Sequence[str], number: int | None, seed: int, root: Path) -> list[Mutant]:
    """Return a sample of the mutants: slice `seed` (from 1) of one shuffled list of all."""
    paths = sorted(path for pattern in patterns for path in root.glob(pattern) if path.stem != "__init__")
    sources = {str(path.relative_to(root)): path.read_text(encoding="utf-8") for path in paths}
    mutants = [Mutant(name, text, change) for name, text in sources.items() for change in mutations_of(text)]
    random.Random(0).shuffle(mutants)
    number = len(mutants) if number is None else number
    if (seed - 1) * number >= len(mutants):
        sys.exit(f"--seed {seed}: there are {len(mutants)} mutants, {number} a seed")
    return sorted(mutants[(seed - 1) * number : seed * number], key=lambda m: (m.module, m.mutation.start))


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


def count_killed(laboratory: Laboratory, mutants: Sequence[Mutant]) -> list[dict[str, Any]]:
    """Run every mutant and print those that survive; return the counts of every module."""
    outcomes: dict[str, list[bool]] = {}
    for mutant in mutants:
        killed = laboratory.killed(mutant)
        for name in (mutant.module, "all"):
            outcomes.setdefault(name, []).append(killed)
        if not killed:
            print(f"survived: {mutant.module}\n{mutant.mutation.diff(mutant.source)}\n", flush=True)
    return [
        {"module": name, "mutants": len(killed), "killed": sum(killed), "share": sum(killed) / len(killed)}
        for name, killed in sorted(outcomes.items(), key=lambda item: item[0] == "all")
    ]


def main() -> None:
    """Draw mutants, run their tests, print what survived and the counts."""
    given = arguments(__doc__, "groups", groups=list(GROUPS), number=int, seed=1, quick=False)
    for name in PRELOADED:
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as folder:
        laboratory = Laboratory(Path(folder))
        for name in given.groups:
            number, patterns = GROUPS.get(name, (None, (name,)))
            number = given.number or (8 if given.quick else number)
            mutants = draw(patterns, number, given.seed, laboratory.folder)
            print_rows(count_killed(laboratory, mutants), f"{name}, seed {given.seed}", width=130)


if __name__ == "__main__":
    main()
