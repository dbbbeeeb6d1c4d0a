"""Size and language of the product stay within the limits of style_limits.toml."""

import ast
import re
import subprocess
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIMITS = tomllib.loads(Path(__file__).with_name("style_limits.toml").read_text(encoding="utf-8"))
PACKAGES = ("lirs_wct", "envs", "slam_baselines", "lirs_validation", "lirs_extensions")
OWN = "lirs_wct|lirs_envs|slam_baselines|lirs_validation|lirs_extensions"
OWN_IMPORT = re.compile(rf"^ *(from (\.|({OWN})\b)|import ({OWN})\b)", re.MULTILINE)
OPENING = re.compile(r"^(What|Who|Whose|Whom|How|Where|Which)\b")
FROM_OUTSIDE = re.compile(r"rpe_metre")
BRITISH = re.compile(
    r"metre|colour|centre|neighbour|behaviour|grey|normalise|serialise|initialise|modelling|labelled"
    r"|\banalyse[dr]?\b"
)
VAGUE = re.compile(
    r"^\s+\*{0,2}\w+(?: \([^)]*\))?: (?:of|that|the same|its|where|in which|with which|by which|from which"
    r"|to which|for which|at which|on which|whose|as)\b"
)
"""A line on an attribute or argument that does not say what the value is."""
WITHOUT_NOUN = re.compile(
    r"^_?(?:LEAST|MOST|FEWEST|FEW|MANY|WIDE|WIDEST|NARROW|NEAR|FAR|MARGIN|BRIEF|SMALL|LARGE|FINE|KEPT|GIVEN"
    r"|ABOVE|BELOW|BEHIND|AROUND|ACROSS|LONGEST|SLOWEST|FASTEST|STEEPEST|FLATTEST|SPARE)$"
)
"""Names of constants that say no quantity."""
PARTICIPLE = re.compile(r"^_*[a-z]+ed$")
VERBS = {"seed", "speed", "feed", "need"}


@cache
def sources() -> dict[str, str]:
    """Return the text of each tracked product file."""
    listed = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("not a git checkout")
    names = [name for name in listed.stdout.split() if name.startswith(PACKAGES)]
    return {name: (ROOT / name).read_text(encoding="utf-8") for name in names if (ROOT / name).exists()}


@cache
def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(text) for name, text in sources().items()}


def nodes() -> Iterator[ast.AST]:
    for tree in trees().values():
        yield from ast.walk(tree)


def docstrings() -> list[str]:
    kinds = (ast.FunctionDef, ast.ClassDef, ast.Module)
    return [doc for node in nodes() if isinstance(node, kinds) and (doc := ast.get_docstring(node))]


def participles() -> list[str]:
    return [
        node.name
        for node in nodes()
        if isinstance(node, ast.FunctionDef)
        and not {"property", "cached_property"} & {getattr(d, "id", "") for d in node.decorator_list}
        and PARTICIPLE.match(node.name)
        and node.name.lstrip("_") not in VERBS
    ]


def first_sentence(doc: str) -> str:
    return re.split(r"(?<=[.!?])\s|\n\n", doc.strip())[0]


def test_size() -> None:
    lines = {name: text.count("\n") for name, text in sources().items()}
    extensions = sum(count for name, count in lines.items() if name.startswith("lirs_extensions/"))
    found = {
        "product_lines": sum(lines.values()),
        "core_lines": sum(lines.values()) - extensions,
        "extension_lines": extensions,
        "product_files": len(sources()),
        "own_imports_per_file": sum(len(OWN_IMPORT.findall(text)) for text in sources().values())
        / len(sources()),
    }
    assert {name: value for name, value in found.items() if value > LIMITS[name]} == {}


@pytest.mark.slow
def test_docstrings_are_plain() -> None:
    docs = docstrings()
    words = [word.lower() for doc in docs for word in re.findall(r"[A-Za-z']+", doc)]
    openings = [first_sentence(doc) for doc in docs if OPENING.match(doc)]
    long = [doc for doc in docs if len(first_sentence(doc).split()) > 15]
    assert len(openings) <= LIMITS["docstring_openings"], openings
    assert len(long) / len(docs) <= LIMITS["long_first_sentences"]
    assert 1e4 * words.count("what") / len(words) <= LIMITS["what_per_10000_words"]


@pytest.mark.slow
def test_functions_are_verbs() -> None:
    found = participles()
    assert len(found) <= LIMITS["participle_functions"], found


def test_spelling_is_american() -> None:
    found = [
        f"{name}: {match.group(0)}"
        for name, text in sources().items()
        for match in BRITISH.finditer(FROM_OUTSIDE.sub("", text.lower()))
    ]
    assert len(found) <= LIMITS["british_spellings"], found


@pytest.mark.slow
def test_class_names_are_unique() -> None:
    names = Counter(
        node.name for tree in trees().values() for node in tree.body if isinstance(node, ast.ClassDef)
    )
    twice = sorted(name for name, count in names.items() if count > 1)
    assert len(twice) <= LIMITS["class_names_twice"], twice


def test_attribute_lines_say_what_the_value_is() -> None:
    found = [
        f"{name}:{number} {line.strip()}"
        for name, text in sources().items()
        for number, line in enumerate(text.splitlines(), 1)
        if VAGUE.match(line)
    ]
    assert len(found) <= LIMITS["vague_attribute_lines"], found


@pytest.mark.slow
def test_constants_name_a_quantity() -> None:
    found = [
        f"{name}:{target.lineno} {target.id}"
        for name, tree in trees().items()
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in ast.walk(node)
        if isinstance(target, ast.Name)
        and isinstance(target.ctx, ast.Store)
        and WITHOUT_NOUN.match(target.id)
    ]
    assert not found
