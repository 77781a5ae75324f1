"""Numbers written as a formula of named ones, such as "-k/m" or "2*(a + 1)^2": + - * / ^, parentheses, names, nothing else.

sum = product {(+ | -) product},  product = signed {(* | /) signed},  signed = [+ | -] power,  power = atom [^ signed]
"""

import operator
import re
from collections.abc import Callable, Mapping
from typing import TypeAlias

LONGEST = 100  # characters: a formula this long is nested less deep than Python can follow
TOKEN = re.compile(r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z]\w*)|([-+*/^()]))")
OPERATORS: dict[str, Callable[[complex, complex], complex]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "^": operator.pow,
}
Tree: TypeAlias = "float | str | tuple[str, Tree, Tree]"  # a number, a name, or an operator between two


def parse_formula(text: str) -> Tree:
    """Return a formula as a tree; raise ValueError, which says what is wrong, where it is none."""
    if len(text) > LONGEST:
        raise ValueError(f"a formula of at most {LONGEST} characters")
    tokens, at = [], 0
    while text[at:].strip():
        found = TOKEN.match(text, at)
        if not found:
            raise ValueError(f"a formula of numbers, names, + - * / ^ and parentheses (not '{text[at:].strip()[0]}')")
        tokens.append(found[1] or found[2] or found[3])
        at = found.end()
    tree, rest = _sum(tokens)
    if rest:
        raise ValueError(f"a formula that ends before '{rest[0]}'")
    return tree


def names(tree: Tree) -> set[str]:
    """Return the names in a formula."""
    if isinstance(tree, tuple):
        return names(tree[1]) | names(tree[2])
    return {tree} if isinstance(tree, str) else set()


def value(tree: Tree, numbers: Mapping[str, float]) -> float:
    """Return what a formula comes to; raise ValueError where that is no finite number."""
    try:
        found = _value(tree, numbers)
    except ArithmeticError:
        found = float("inf")
    if isinstance(found, complex) or not abs(found) < float("inf"):
        raise ValueError("a finite number")
    return float(found)


def _value(tree: Tree, numbers: Mapping[str, float]) -> complex:
    if isinstance(tree, tuple):
        return OPERATORS[tree[0]](_value(tree[1], numbers), _value(tree[2], numbers))
    return numbers[tree] if isinstance(tree, str) else tree


def _sum(tokens: list[str]) -> tuple[Tree, list[str]]:
    return _chain(tokens, "+-", _product)


def _product(tokens: list[str]) -> tuple[Tree, list[str]]:
    return _chain(tokens, "*/", _parse_signed)


def _chain(
    tokens: list[str], signs: str, part: Callable[[list[str]], tuple[Tree, list[str]]]
) -> tuple[Tree, list[str]]:
    """Parts with signs between them, from the left."""
    tree, rest = part(tokens)
    while rest and rest[0] in signs:
        right, after = part(rest[1:])
        tree, rest = (rest[0], tree, right), after
    return tree, rest


def _parse_signed(tokens: list[str]) -> tuple[Tree, list[str]]:
    if tokens and tokens[0] in "+-":
        tree, rest = _parse_signed(tokens[1:])
        return (tokens[0], 0.0, tree), rest
    base, rest = _atom(tokens)
    if rest and rest[0] == "^":
        power, rest = _parse_signed(rest[1:])
        return ("^", base, power), rest
    return base, rest


def _atom(tokens: list[str]) -> tuple[Tree, list[str]]:
    if not tokens:
        raise ValueError("a formula that goes on where this one ends")
    first, rest = tokens[0], tokens[1:]
    if first == "(":
        tree, rest = _sum(rest)
        if not rest or rest[0] != ")":
            raise ValueError("a formula whose parentheses are closed")
        return tree, rest[1:]
    if first in "*/^)":
        raise ValueError(f"a number or a name before '{first}'")
    return (first if first[0].isalpha() else float(first)), rest
