"""Formulas of named numbers, such as "-k/m" or "2*(a + 1)^2", with + - * / ^, parentheses and names only.

sum = product {(+ | -) product},  product = signed {(* | /) signed},  signed = [+ | -] power,  power = atom [^ signed]

A formula of the fields of a recording may call `functions`, and has names such as `pose.x` or, in quotes, 'Temp °C'.
"""

import operator
import re
from collections.abc import Callable, Collection, Mapping
from typing import TypeAlias

LONGEST = 100  # characters, or tokens for formulas of fields: limits the nesting depth below Python's
LONGEST_NAMES = 1000  # characters of a formula of fields
NUMBER = r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
TOKEN = re.compile(NUMBER + r"|([A-Za-z]\w*)|([-+*/^()]))")
FIELD = re.compile(NUMBER + r"|([A-Za-z_]\w*(?:\.\w+)*|'[^']+')|([-+*/^(),]))")
OPERATORS: dict[str, Callable[[complex, complex], complex]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "^": operator.pow,
}
# a number, a name, an operator with two operands, or a function call
Tree: TypeAlias = "float | str | tuple[str, *tuple[Tree, ...]]"
Part: TypeAlias = (
    "Callable[[list[str], Collection[str]], tuple[Tree, list[str]]]"  # parses the start of a list of tokens
)


def parse_formula(text: str, functions: Collection[str] = ()) -> Tree:
    """Return a formula as a tree; raise ValueError with the expected form if it is invalid."""
    longest = LONGEST_NAMES if functions else LONGEST
    tokens, at = [], 0
    while text[at:].strip() and len(text) <= longest:
        match = (FIELD if functions else TOKEN).match(text, at)
        if not match:
            calls = ", functions" if functions else ""
            raise ValueError(
                f"a formula of numbers, names, + - * / ^{calls} and parentheses (not '{text[at:].strip()[0]}')"
            )
        tokens.append(match[1] or match[2] or match[3])
        at = match.end()
    if len(text) > longest or len(tokens) > LONGEST:
        raise ValueError(
            f"a formula of at most {longest} characters" + f", {LONGEST} words and signs" * bool(functions)
        )
    tree, rest = _sum(tokens, functions)
    if rest:
        raise ValueError(f"a formula that ends before '{rest[0]}'")
    return tree


def names(tree: Tree) -> set[str]:
    """Return the names in a formula."""
    if isinstance(tree, tuple):
        return set[str]().union(*map(names, tree[1:]))
    return {tree} if isinstance(tree, str) else set()


def value(tree: Tree, numbers: Mapping[str, float]) -> float:
    """Return the value of a formula; raise ValueError if it is not finite."""
    try:
        result = _value(tree, numbers)
    except ArithmeticError:
        result = float("inf")
    if isinstance(result, complex) or not abs(result) < float("inf"):
        raise ValueError("a finite number")
    return float(result)


def _value(tree: Tree, numbers: Mapping[str, float]) -> complex:
    if isinstance(tree, tuple):
        return OPERATORS[tree[0]](*(_value(operand, numbers) for operand in tree[1:]))
    return numbers[tree] if isinstance(tree, str) else tree


def _sum(tokens: list[str], functions: Collection[str]) -> tuple[Tree, list[str]]:
    return _chain(tokens, "+-", functions, _product)


def _product(tokens: list[str], functions: Collection[str]) -> tuple[Tree, list[str]]:
    return _chain(tokens, "*/", functions, _parse_signed)


def _chain(tokens: list[str], signs: str, functions: Collection[str], part: Part) -> tuple[Tree, list[str]]:
    """Parse operands separated by signs, from the left."""
    tree, rest = part(tokens, functions)
    while rest and rest[0] in signs:
        right, after = part(rest[1:], functions)
        tree, rest = (rest[0], tree, right), after
    return tree, rest


def _parse_signed(tokens: list[str], functions: Collection[str]) -> tuple[Tree, list[str]]:
    if tokens and tokens[0] in "+-":
        tree, rest = _parse_signed(tokens[1:], functions)
        return (tokens[0], 0.0, tree), rest
    base, rest = _atom(tokens, functions)
    if rest and rest[0] == "^":
        power, rest = _parse_signed(rest[1:], functions)
        return ("^", base, power), rest
    return base, rest


def _atom(tokens: list[str], functions: Collection[str]) -> tuple[Tree, list[str]]:
    if not tokens:
        raise ValueError("a formula that goes on where this one ends")
    first, rest = tokens[0], tokens[1:]
    call = bool(functions) and rest[:1] == ["("] and (first[0].isalpha() or first[0] == "_")
    if call and first not in functions:
        raise ValueError(f"one of the functions {', '.join(sorted(functions))} before '(', not '{first}'")
    if call or first == "(":
        inner, rest = _sum(rest[1:] if call else rest, functions)
        arguments = [inner]
        while call and rest[:1] == [","]:
            inner, rest = _sum(rest[1:], functions)
            arguments.append(inner)
        if not rest or rest[0] != ")":
            raise ValueError("a formula whose parentheses are closed")
        return (first, *arguments) if call else inner, rest[1:]
    if first in "*/^),":
        raise ValueError(f"a number or a name before '{first}'")
    return (float(first) if first[0].isdecimal() or first[0] == "." else first.strip("'")), rest
