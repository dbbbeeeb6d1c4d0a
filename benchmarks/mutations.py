"""Small mutations of a module's source: what a slip of the pen would make of it, one at a time.

Changed are comparisons, arithmetic, boolean and unary operators, numbers, conditions, pairs of functions such
as `min` and `max`, ends of `range`, `break` and `continue`. Left alone are texts, annotations and decorators.
"""

from __future__ import annotations

import ast
import copy
import difflib
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
FUNCTIONS = [
    ("min", "max"),
    ("minimum", "maximum"),
    ("nanmin", "nanmax"),
    ("argmin", "argmax"),
    ("floor", "ceil"),
    ("any", "all"),
    ("sin", "cos"),
    ("zeros", "ones"),
    ("radians", "degrees"),
]
TWIN = {**dict(FUNCTIONS), **{b: a for a, b in FUNCTIONS}}
GUARDS = ("strict", "stacklevel")
"""Arguments without a say in what comes out."""
OPERATIONS = (ast.BinOp, ast.BoolOp, ast.Compare, ast.UnaryOp)
Node = ast.expr | ast.stmt


@dataclass(frozen=True)
class Mutation:
    """A text in place of a node's.

    Attributes:
        start: first byte of the node in the source (UTF-8).
        end: first byte behind it.
        text: what stands there instead.
    """

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
                for other in COMPARISONS[type(op)]:
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
            yield from ((node, ast.Constant(other)) for other in _numbers(value))
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


def _numbers(value: bool | int | float) -> list[bool | int | float]:
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        return [value - 1, value + 1]
    return [value * 2, value / 2] if value else [1.0]


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed
