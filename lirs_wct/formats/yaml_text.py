"""Strict reading of YAML text: a duplicate key is an error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from lirs_wct.errors import reason_of

if TYPE_CHECKING:
    from yaml.constructor import BaseConstructor as _Constructor
else:
    _Constructor = object
MERGE = "tag:yaml.org,2002:merge"
"""Tag of the key `<<`, which may occur several times."""


class _UniqueKeys(_Constructor):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE:
                continue
            if key.value in lines:
                raise yaml.MarkedYAMLError(
                    problem=f"the key {key.value!r} stands on line {lines[key.value]}, too; legal is one",
                    problem_mark=key.start_mark,
                )
            lines[key.value] = key.start_mark.line + 1
        return super().construct_mapping(node, deep)


class _Typed(_UniqueKeys, yaml.SafeLoader):
    """Numbers, booleans and dates as YAML defines them."""


class _Text(_UniqueKeys, yaml.BaseLoader):
    """Scalars as text."""


def load_yaml(text: str, *, typed: bool = True) -> Any:
    """Return the value of a YAML text.

    Args:
        text: one document.
        typed: whether scalars become numbers, booleans and dates; they stay text otherwise.

    Raises:
        ValueError: no YAML, or a duplicate key; the message is one line that names the line.
    """
    try:
        return yaml.load(text, _Typed if typed else _Text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reasons = ", ".join(reason for reason in (error.context, error.problem) if reason)
        raise ValueError(f"line {mark.line + 1 if mark else 1}: {reasons}") from error
    except yaml.YAMLError as error:
        raise ValueError(f"is not YAML: {str(error).splitlines()[0]}") from error
    except (ValueError, RecursionError) as error:  # such as a number of 5,000 digits
        raise ValueError(f"is not YAML: {reason_of(error)}") from error
