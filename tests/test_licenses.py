"""No run-time dependency is under the GPL or the AGPL, by what its distribution declares."""

import re
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
LONGEST = 200
"""Characters of a field that names a license; a longer one quotes its text."""
ALLOWED = {
    r"LGPL|(library or )?lesser general public license": "programs that use the library keep their license",
    # Wheels of NumPy and SciPy hold GCC's run-time libraries.
    r"GPL-[\d.]+(-only|-or-later)?[ -]with[ -]GCC-exception(-[\d.]+)?": "the exception covers all programs",
}
"""Patterns of licenses that only look like the GPL, with the reason why each is allowed."""
GPL = re.compile(r"GPL|general public license", re.IGNORECASE)


def dependencies() -> dict[str, Distribution]:
    """Return the distributions that an installation without extras brings, by name."""
    # Not from the metadata of an editable installation, which may be older than the file.
    declared = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["dependencies"]
    left, found, seen = [need for need in map(Requirement, declared) if applies(need)], {}, set()
    while left:
        wanted = left.pop()
        name = canonicalize_name(wanted.name)
        found[name] = distribution(name)
        for extra in {"", *wanted.extras}:
            if (name, extra) not in seen:
                seen.add((name, extra))
                needs = map(Requirement, found[name].requires or ())
                left += [need for need in needs if applies(need, extra)]
    return found


def applies(need: Requirement, extra: str = "") -> bool:
    return need.marker is None or need.marker.evaluate({"extra": extra})


def licenses(held: Distribution) -> list[str]:
    """Return the licenses that the metadata name: expression, field and classifiers."""
    fields = [held.metadata.get("License-Expression", ""), held.metadata.get("License", "")]
    fields += [line for line in held.metadata.get_all("Classifier", []) if line.startswith("License ::")]
    return [field for field in fields if field and len(field) <= LONGEST]


def is_gpl(field: str) -> bool:
    for pattern in ALLOWED:
        field = re.sub(pattern, "", field, flags=re.IGNORECASE)
    return GPL.search(field) is not None


def test_no_dependency_is_under_the_gpl() -> None:
    found = {name: licenses(held) for name, held in dependencies().items()}
    assert {"numpy", "matplotlib", "contourpy"} <= set(found)
    assert [name for name, fields in found.items() if not fields] == [], "name no license"
    assert {name: fields for name, fields in found.items() if any(map(is_gpl, fields))} == {}


@pytest.mark.parametrize(
    ("field", "gpl"),
    [
        ("MIT AND GPL-3.0-or-later", True),
        ("GPLv2+", True),
        ("AGPL-3.0-only", True),
        ("License :: OSI Approved :: GNU General Public License v3 (GPLv3)", True),
        ("License :: OSI Approved :: GNU Affero General Public License v3", True),
        ("LGPL-2.1-only AND GPL-3.0-only", True),
        ("License :: OSI Approved :: GNU Library or Lesser General Public License (LGPL)", False),
        ("License :: OSI Approved :: GNU Lesser General Public License v2 (LGPLv2)", False),
        ("BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1", False),
        ("GPL-3.0-with-GCC-exception", False),
        ("License :: OSI Approved :: Mozilla Public License 2.0 (MPL 2.0)", False),
    ],
)
def test_the_gpl_is_told_from_what_looks_like_it(field: str, gpl: bool) -> None:
    assert is_gpl(field) == gpl


def test_a_gpl_library_that_only_tests_use_is_seen() -> None:
    assert any(map(is_gpl, licenses(distribution("evo"))))
