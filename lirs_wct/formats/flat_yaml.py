"""The little of YAML that map files use: flat `key: value` with numbers, words and lists of numbers."""

from __future__ import annotations

import re

Value = float | str | list[float]

_LINE = re.compile(r"^(?P<key>[A-Za-z_][\w-]*)\s*:(?:\s+(?P<value>.*))?$")
_ITEM = re.compile(r"^\s*-\s+(?P<value>.+)$")


def parse(text: str) -> dict[str, Value]:
    """Return the keys of a flat YAML document.

    Raises:
        ValueError: something that a map file has no use for (nesting, anchors, two documents).
    """
    found: dict[str, Value] = {}
    key = ""
    for number, raw in enumerate(text.splitlines(), start=1):
        line = _without_comment(raw).rstrip()
        if not line or (line == "---" and not found):
            continue
        item, pair = _ITEM.match(line), _LINE.match(line)
        items = found.get(key)
        if item and isinstance(items, list):
            items.append(_number(item["value"], number))
        elif pair:
            key = pair["key"]
            found[key] = _value((pair["value"] or "").strip(), number)
        else:
            raise ValueError(f"line {number} is not `key: value`: {raw.strip()!r}")
    return found


def _without_comment(line: str) -> str:
    """Cut a comment, which begins with # at the start or after a blank, but not inside quotes."""
    quote = ""
    for at, char in enumerate(line):
        if char in "\"'":
            quote = "" if quote == char else quote or char
        elif char == "#" and not quote and (at == 0 or line[at - 1].isspace()):
            return line[:at]
    return line


def _value(text: str, line: int) -> Value:
    if text == "":
        return []
    if text[0] == "[":
        if text[-1] != "]":
            raise ValueError(f"line {line}: the list does not end")
        return [_number(part, line) for part in text[1:-1].split(",") if part.strip()]
    if text[0] in "\"'":
        if len(text) < 2 or text[-1] != text[0]:
            raise ValueError(f"line {line}: the quote does not end")
        return text[1:-1]
    if text[0] in "{&*!|>":
        raise ValueError(f"line {line}: a map file has no use for {text!r}")
    try:
        return float(text)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(text.lower(), text)


def _number(text: str, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"line {line}: {text.strip()!r} is not a number") from None
