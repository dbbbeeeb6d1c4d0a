"""JSON schema of a run's record, and validation against it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lirs_validation.record.run_record import read_record
from lirs_wct.errors import SourceError

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator


def record_schema() -> dict[str, Any]:
    """Return the JSON schema of `record.json`."""
    text = files(__package__).joinpath("record.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def schema_error(entry: Mapping[str, Any]) -> str | None:
    """Return the first schema violation in one line; None if valid."""
    from jsonschema.exceptions import best_match  # imported here: a new run has no record to be checked

    error = best_match(_validator().iter_errors(entry))
    if error is not None:
        place = ".".join(str(part) for part in error.absolute_path) or "record"
        return " ".join(f"{place}: {error.message}".split())[:200]
    try:
        json.dumps(entry, allow_nan=False)
    except ValueError:
        return "record: a number is not finite"
    return None


def read_whole_record(folder: Path) -> dict[str, Any]:
    """Read a run's `record.json`.

    Raises:
        SourceError: missing, damaged, of another schema, or something in it does not fit the schema.
    """
    entry = read_record(folder)
    problem = schema_error(entry)
    if problem is not None:
        raise SourceError(f"{folder / 'record.json'}: damaged: {problem}")
    return entry


@cache
def _validator() -> Draft202012Validator:
    from jsonschema import Draft202012Validator

    return Draft202012Validator(record_schema())
