"""The public interface is that of public_interface.json; a change of it is a choice, written with

python tests/test_public_interface.py
"""

import json
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import click
import pytest
from gymnasium import registry

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.tasks.task import Rewards
from lirs_validation.record.run_record import record_schema
from tests.command_line import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
STORED = Path(__file__).with_name("public_interface.json")
DIRECTIVE = re.compile(r"^\.\. (currentmodule|automodule|autoclass|autofunction):: ([\w.]+)$", re.MULTILINE)


def documented_names() -> Iterator[str]:
    """Yield the names that docs/reference documents."""
    for page in sorted((ROOT / "docs/reference").glob("*.md")):
        module = ""
        for kind, name in DIRECTIVE.findall(page.read_text(encoding="utf-8")):
            if kind == "currentmodule":
                module = name
            elif kind == "automodule":
                own = vars(resolve_name(name)).items()
                yield from (f"{name}.{k}" for k, v in own if getattr(v, "__module__", "") == name)
            else:
                yield name if "." in name else f"{module}.{name}"


def public_names() -> set[str]:
    """Return the names that are documented or in `__all__`, and exist."""
    names = set(documented_names())
    for module in ("lirs_wct", "lirs_envs.lidar", "lirs_validation"):
        names |= {f"{module}.{name}" for name in resolve_name(module).__all__}
    return {name for name in names if exists(name)}


def exists(name: str) -> bool:
    try:
        resolve_name(name)
    except (AttributeError, ImportError):
        return False
    return True


def options() -> Iterator[str]:
    """Yield each command and each of its flags, and each option that only `--option` takes."""
    for name, command in COMMANDS.items():
        yield name
        flags = (flag for param in command.params if isinstance(param, click.Option) for flag in param.opts)
        yield from (f"{name} {flag}" for flag in flags)
    own = {option.flag for command in COMMANDS.values() for option in command.own.values()}
    rare = {option.flag for command in COMMANDS.values() for option in command.rare.values()}
    yield from (f"rare {flag}" for flag in rare - own)


def default(field: Field[Any]) -> str:
    if field.default_factory is not MISSING:
        return repr(field.default_factory())
    return "required" if field.default is MISSING else repr(field.default)


def keys(node: Any, place: str = "") -> Iterator[str]:
    """Yield the path of each property that a part of the record's schema describes."""
    if "$ref" in node:
        yield from keys(record_schema()["$defs"][node["$ref"].rpartition("/")[2]], place)
    for choice in node.get("anyOf", ()):
        yield from keys(choice, place)
    if "items" in node:
        yield from keys(node["items"], f"{place}[]")
    for name, held in node.get("properties", {}).items():
        path = f"{place}.{name}".lstrip(".")
        yield path
        yield from keys(held, path)


def interface() -> dict[str, list[str]]:
    parts = {
        "names": public_names(),
        "options": options(),
        "environments": (name for name in registry if name.startswith("LIRS/")),
        "defaults": (
            f"{held.__name__}.{field.name} = {default(field)}"
            for held in (EnvConfig, Rewards)
            for field in fields(held)
            if field.init
        ),
        "record": keys(record_schema()),
    }
    return {part: sorted(set(entries)) for part, entries in parts.items()}


@pytest.mark.parametrize("part", ["names", "options", "environments", "defaults", "record"])
def test_the_public_interface_is_the_stored_one(part: str) -> None:
    stored, found = (set(held[part]) for held in (json.loads(STORED.read_text("utf-8")), interface()))
    added, removed = sorted(found - stored), sorted(stored - found)
    if added or removed:
        pytest.fail(
            f"{part}: added {added}, removed {removed}; if meant: python tests/{Path(__file__).name}",
            pytrace=False,
        )


if __name__ == "__main__":
    STORED.write_text(json.dumps(interface(), indent=1) + "\n", encoding="utf-8")
