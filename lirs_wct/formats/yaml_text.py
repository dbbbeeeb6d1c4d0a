"""YAML text: strict reading as values, and as text by the rules of yaml-cpp."""

from __future__ import annotations

from typing import Any

import yaml

from lirs_wct.errors import reason_of

MERGE = "tag:yaml.org,2002:merge"
"""Tag of the key `<<`, which may occur several times."""


class _Typed(yaml.SafeLoader):
    """Numbers, booleans and dates as YAML defines them; a duplicate key is an error."""

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


class _Text(yaml.BaseLoader):
    """Scalars as text and mappings as pairs; as in yaml-cpp, tabs may stand between tokens."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
        return self.construct_pairs(node, deep=True)

    def scan_to_next_token(self) -> None:
        super().scan_to_next_token()
        while self.peek() == "\t":
            self.allow_simple_key &= self.flow_level > 0  # a tab does not indent
            self.forward()
            super().scan_to_next_token()


def load_yaml(text: str, *, typed: bool = True) -> Any:
    """Return the value of a YAML text; raise a ValueError of one line that names the line.

    Untyped, scalars stay text, mappings are lists of pairs, and further documents are left out.
    """
    try:
        return yaml.load(text, _Typed) if typed else next(yaml.load_all(text, _Text), None)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reasons = ", ".join(reason for reason in (error.context, error.problem) if reason)
        raise ValueError(f"line {mark.line + 1 if mark else 1}: {reasons}") from error
    except yaml.YAMLError as error:
        raise ValueError(f"is not YAML: {str(error).splitlines()[0]}") from error
    except (ValueError, RecursionError) as error:  # such as a number of 5,000 digits
        raise ValueError(f"is not YAML: {reason_of(error)}") from error
