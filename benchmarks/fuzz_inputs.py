"""Damaged input files against the command line: each ends in one clear line, quickly, in little memory.

    python benchmarks/fuzz_inputs.py --count 1000 --seed 1

Valid files of every kind are written, one is mutated per input, and the command that reads it runs in a
forked process. Demanded of every input: exit code 0, 2 or 3; lines of ours alone on stderr; for 2 exactly one
line, which starts with the path of a file; no traceback, no bare name of an exception, no output of a C
library; below the limits of time and memory; nothing half-written.
"""

from __future__ import annotations

import argparse
import contextlib
import gzip
import os
import re
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from benchmarks.fuzz_seeds import KINDS, Kind, call, write_seeds

LIMIT_S, HANG_S, LIMIT_GB, ADDRESS_GB = 10.0, 60.0, 1.0, 6.0
"""Processor seconds, wall seconds and resident memory of one input; address space, beyond which an
allocation fails. Processor time does not depend on the load of the machine."""
ODD_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "-1", "0", "1e-300", "99999999999999999999", "", "x")
EXTREME_WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
HEADER = 256
"""Bytes at the start of a binary file that count as its header."""
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
BARE_NAME = re.compile(r"\b[A-Z]\w*(?:Error|Exception)\b|validation errors? for|See previous exception")
LIBRARY = re.compile(
    r"Traceback|libpng|libjpeg|TIFFRead|TIFFFetch|TIFFOpen|CPLE_|RuntimeWarning|UserWarning|"
    r"DeprecationWarning|\[ WARN|\[ERROR|site-packages|^Corrupt JPEG|terminate called|Segmentation",
    re.MULTILINE,
)


@dataclass(frozen=True)
class Outcome:
    """Result of one input.

    Attributes:
        kind: of the file.
        mutation: name of the mutation.
        code: exit status; negative = signal.
        seconds: processor time.
        gigabytes: largest resident memory.
        said: stderr.
        problems: broken demands, empty if none.
    """

    kind: str
    mutation: str
    code: int
    seconds: float
    gigabytes: float
    said: str
    problems: tuple[str, ...]


def mutate(data: bytes, rng: np.random.Generator, *, text: bool) -> tuple[str, bytes]:
    """Return the name of a random mutation and the mutated bytes."""
    common: list[Callable[[bytes, np.random.Generator], bytes]] = [_truncate, _flip, _noise, _empty, _double]
    special = [*[_odd_number] * 3, _drop_line, _long] if text else [_extreme, _extreme, _zero]
    chosen = (common + special)[int(rng.integers(len(common) + len(special)))]
    return chosen.__name__.strip("_"), chosen(data, rng)


def _mutated(kind: Kind, data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Mutate a file; what is gzipped half of the time inside."""
    if not kind.file.endswith(".gz"):
        return mutate(data, rng, text=kind.text)
    if rng.random() < 0.5:
        return mutate(data, rng, text=False)
    name, inside = mutate(gzip.decompress(data), rng, text=kind.text)
    return name, gzip.compress(inside, 1)


def _truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for place in rng.integers(len(out), size=int(rng.integers(1, 20))).tolist():
        out[place] ^= int(rng.integers(1, 256))
    return bytes(out)


def _noise(data: bytes, rng: np.random.Generator) -> bytes:
    return rng.bytes(int(rng.integers(1, 4096)))


def _empty(data: bytes, rng: np.random.Generator) -> bytes:
    return b""


def _double(data: bytes, rng: np.random.Generator) -> bytes:
    return data + data


def _extreme(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a 1, 2, 4 or 8 byte number in the header."""
    out, width = bytearray(data), int(rng.choice((1, 2, 4, 8)))
    place = int(rng.integers(max(min(HEADER, len(out)) - width, 1)))
    word = EXTREME_WORDS[int(rng.integers(len(EXTREME_WORDS)))]
    order = "little" if rng.random() < 0.5 else "big"
    out[place : place + width] = (word & (256**width - 1)).to_bytes(width, order)
    return bytes(out)


def _zero(data: bytes, rng: np.random.Generator) -> bytes:
    place, length = int(rng.integers(len(data))), int(rng.integers(1, 64))
    return data[:place] + bytes(min(length, len(data) - place)) + data[place + length :]


def _odd_number(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a number; the first numbers, which head most formats, are chosen half of the time."""
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    few = found[:12] if rng.random() < 0.5 else found
    hit = few[int(rng.integers(len(few)))]
    odd = ODD_NUMBERS[int(rng.integers(len(ODD_NUMBERS)))].encode()
    return data[: hit.start()] + odd + data[hit.end() :]


def _drop_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.splitlines(keepends=True)
    del lines[int(rng.integers(len(lines)))]
    return b"".join(lines)


def _long(data: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(data)))
    return data[:place] + b"9" * 100_000 + data[place:]


def run_input(kind: Kind, folder: Path, rng: np.random.Generator, keep: Path | None = None) -> Outcome:
    """Mutate a copy of a kind's valid files, run its command on them, and check the outcome."""
    work = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        shutil.copytree(folder, work / "in", symlinks=True)
        target = work / "in" / kind.file
        mutation, data = _mutated(kind, target.read_bytes(), rng)
        if kind.wrong_suffixes and rng.random() < 0.1:
            mutation, data = "suffix", target.read_bytes()
            renamed = target.with_suffix(kind.wrong_suffixes[int(rng.integers(len(kind.wrong_suffixes)))])
            target.rename(renamed)
            target = renamed
        target.write_bytes(data)
        command = kind.commands[int(rng.integers(len(kind.commands)))]
        arguments = [a.replace("{}", str(target.relative_to(work))) for a in command.split()]
        outcome = _forked(kind.name, mutation, arguments, work)
        if outcome.problems and keep is not None:
            shutil.copytree(work, keep, dirs_exist_ok=True)
            (keep / "command.txt").write_text(" ".join(arguments) + "\n" + outcome.said, encoding="utf-8")
        return outcome
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _forked(kind: str, mutation: str, arguments: Sequence[str], work: Path) -> Outcome:
    started = time.monotonic()
    before = _listing(work)
    child = os.fork()
    if child == 0:
        _child(arguments, work)
    status, usage, late = _wait(child, started)
    seconds = usage.ru_utime + usage.ru_stime
    said = (work / "stderr").read_text(encoding="utf-8", errors="replace")
    code = os.waitstatus_to_exitcode(status)
    gigabytes = usage.ru_maxrss / 2**20
    left = sorted(_listing(work) - before - {"stderr", "stdout"})
    if late:
        problems: tuple[str, ...] = (f"not ended after {HANG_S:g} s",)
    else:
        problems = (*_problems(code, said, seconds, gigabytes, left), *_refusal_problems(code, said, before))
    return Outcome(kind, mutation, code, seconds, gigabytes, said, problems)


def _child(arguments: Sequence[str], work: Path) -> None:
    """Run the command line in this forked process; never returns."""
    try:
        os.chdir(work)
        for name, number in (("stdout", 1), ("stderr", 2)):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
        resource.setrlimit(resource.RLIMIT_AS, (int(ADDRESS_GB * 2**30),) * 2)
        try:
            code = call(arguments)
        except BaseException:  # as the interpreter would print it
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    finally:
        os._exit(99)


def _wait(child: int, started: float) -> tuple[int, resource.struct_rusage, bool]:
    """Wait for a child; kill it after the limit."""
    handle = os.pidfd_open(child)
    try:
        ready, _, _ = select.select([handle], [], [], max(0.0, HANG_S - (time.monotonic() - started)))
        if not ready:
            os.kill(child, signal.SIGKILL)
        _, status, usage = os.wait4(child, 0)
    finally:
        os.close(handle)
    return status, usage, not ready


def _listing(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


def _problems(code: int, said: str, seconds: float, gigabytes: float, left: Sequence[str]) -> tuple[str, ...]:
    """Return the demands that an outcome breaks."""
    lines = said.splitlines()
    ours = [line for line in lines if line.startswith("lirs-wct: ") or line.startswith("skipped ")]
    found = []
    if code not in (0, 2, 3):
        found.append(f"exit code {code}")
    if len(ours) < sum(bool(line.strip()) and not _is_note(line) for line in lines):
        found.append("output that is not ours")
    if match := LIBRARY.search(said):
        found.append(f"library output ({match[0]})")
    if match := BARE_NAME.search(said):
        found.append(f"name of an exception ({match[0]})")
    if len(max(lines, key=len, default="")) > 1000:
        found.append("a line of more than 1,000 characters")
    if seconds > LIMIT_S:
        found.append(f"{seconds:.1f} s")
    if gigabytes > LIMIT_GB:
        found.append(f"{gigabytes:.2f} GB")
    hidden = [name for name in left if "/." in f"/{name}"]
    if hidden or (code == 2 and any((not name.startswith("in/")) for name in left if "." in name)):
        found.append(f"left behind: {', '.join(left[:4])}")
    return tuple(found)


def _refusal_problems(code: int, said: str, inputs: Collection[str]) -> tuple[str, ...]:
    """Return the demands that the message of a refused input breaks."""
    lines = [line for line in said.splitlines() if line.strip() and not _is_note(line)]
    if code != 2:
        return ()
    if len(lines) != 1:
        return (f"exit code 2 with {len(lines)} lines",)
    named = re.match(r"lirs-wct: (in/[^:,\s]*)", lines[0])
    return () if named and named[1] in inputs else ("no path first",)


def _is_note(line: str) -> bool:
    """Whether a line tells of progress or of a log that was mapped."""
    return (", " in line and line.rstrip().endswith("%")) or ": its map is " in line


def warm_up(seeds: Path, kinds: Sequence[Kind]) -> None:
    """Run every command on its valid file: forked processes inherit libraries and kernels."""
    import cv2

    cv2.setNumThreads(1)
    for kind in kinds:
        for command in kind.commands:
            with tempfile.TemporaryDirectory() as work, _quiet(), contextlib.chdir(work):
                shutil.copytree(seeds / kind.name, "in")
                code = call([a.replace("{}", f"in/{kind.file}") for a in command.split()])
            if code:
                raise SystemExit(f"valid {kind.name} ended with {code}: {command}")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the output of this process, also of its C libraries, off the terminal."""
    kept, nowhere = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    _redirect(nowhere, nowhere)
    try:
        yield
    finally:
        _redirect(*kept)
        for handle in (nowhere, *kept):
            os.close(handle)


def _redirect(out: int, err: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(out, 1)
    os.dup2(err, 2)


def run(count: int, seed: int, names: Sequence[str], keep: Path | None) -> list[Outcome]:
    """Run mutated inputs of the kinds in turn."""
    kinds = [kind for kind in KINDS if not names or kind.name in names]
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        seeds = Path(folder)
        with _quiet():
            write_seeds(seeds, kinds)
        warm_up(seeds, kinds)
        for number in range(count):
            kind = kinds[number % len(kinds)]
            where = None if keep is None else keep / f"{number}-{kind.name}"
            outcome = run_input(kind, seeds / kind.name, np.random.default_rng((seed, number)), where)
            outcomes.append(outcome)
            if outcome.problems:
                print(f"{number} {kind.name} {outcome.mutation}: {'; '.join(outcome.problems)}")
                print("    " + outcome.said[-1500:].strip().replace("\n", "\n    "), flush=True)
    return outcomes


def main() -> None:
    """Run the harness and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", default="", help="comma-separated; default: all")
    parser.add_argument("--keep", type=Path, help="folder for inputs that break a demand")
    given = parser.parse_args()
    outcomes = run(given.count, given.seed, [k for k in given.kinds.split(",") if k], given.keep)
    print("exit codes:", dict(Counter(o.code for o in outcomes)))
    slowest, largest = max(outcomes, key=lambda o: o.seconds), max(outcomes, key=lambda o: o.gigabytes)
    print(f"slowest: {slowest.seconds:.1f} s ({slowest.kind}, {slowest.mutation})")
    print(f"largest memory: {largest.gigabytes:.2f} GB ({largest.kind}, {largest.mutation})")
    print(
        f"kinds: {len({o.kind for o in outcomes})}; mutations:", dict(Counter(o.mutation for o in outcomes))
    )
    failed = [o for o in outcomes if o.problems]
    print(f"inputs: {len(outcomes)}, broken demands: {len(failed)}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
