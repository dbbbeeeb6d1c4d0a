"""The mutations that the tests are tried with: each is a program, and another one."""

import ast
from pathlib import Path
from types import ModuleType

import pytest

from tests.benchmark_modules import load_benchmark

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def mutations() -> ModuleType:
    return load_benchmark("mutants")


SOURCE = '''"""A text with 1 + 1."""
LIMIT = 0.5  # ä: offsets are bytes
Kind = int | str

def f(a: int = 3, *, whole: bool = True) -> float:
    """Return 2 < 3."""
    if a < LIMIT and not whole:
        raise ValueError(f"{a + 1}")
    for k in range(2, a):
        a -= k
    return min(a, -1) * 2
'''
EXPECTED = {
    "LIMIT = 1.0", "LIMIT = 0.25",
    "a: int = 2", "a: int = 4", "whole: bool = False",
    "if (a <= LIMIT) and not whole:", "if (a > LIMIT) and not whole:",
    "if (a < LIMIT or not whole):", "if (not (a < LIMIT and (not whole))):", "if a < LIMIT and whole:",
    "range(1, a)", "range(3, a)", "range(2, (a - 1))",
    "a += k",
    "max(a, -1) * 2", "min(a, 1) * 2", "min(a, -0) * 2", "min(a, -2) * 2",
    "return (min(a, -1) / 2)", "min(a, -1) * 1", "min(a, -1) * 3",
}  # fmt: skip


def test_mutations_by_hand(mutations: ModuleType) -> None:
    found = [m.apply(SOURCE) for m in mutations.mutations_of(SOURCE)]
    missing = {text for text in EXPECTED if sum(text in source for source in found) != 1}
    assert not missing
    assert len(found) == len(set(found)) == len(EXPECTED)


def test_the_diff_shows_the_line_before_and_after(mutations: ModuleType) -> None:
    first = mutations.mutations_of(SOURCE)[0]
    assert first.diff(SOURCE).splitlines()[0] == "    2 -LIMIT = 0.5  # ä: offsets are bytes"
    assert first.diff(SOURCE).splitlines()[1].startswith("    2 +LIMIT = ")


@pytest.mark.parametrize("module", ["metrics/map.py", "record/run_record.py"])
def test_every_mutation_is_another_program(mutations: ModuleType, module: str) -> None:
    source = (ROOT / "lirs_validation" / module).read_text(encoding="utf-8")
    programs = {ast.dump(ast.parse(m.apply(source))) for m in mutations.mutations_of(source)}
    assert len(programs) == len(mutations.mutations_of(source)) > 0
    assert ast.dump(ast.parse(source)) not in programs
