"""Operations, bytes and kernels of a compiled program, counted from the text of its optimised HLO; and what a core can do.

XLA's own cost analysis counts the body of a loop once. Here a loop counts as often as it runs: as its text says, or as `trips`
says for the loops without a known number, in the order of the text. Of the branches of a conditional the largest counts.

flops: additions, subtractions, products, divisions, roots, maxima, minima, absolute values and other functions of float64, one
each. integer: sums, products, shifts and bitwise operations of whole numbers, one for each number. Comparisons and choices are
not counted. bytes: what kernels read and write; of an array that a kernel only reads slices of, the slices.
kernels: fusions and other operations that make a loop over an array.
"""

import re
from collections.abc import Callable, Iterator
from time import process_time
from typing import NamedTuple

import numba
import numpy as np

SIZES = {"f64": 8, "s64": 8, "u64": 8, "f32": 4, "s32": 4, "u32": 4, "s16": 2, "u16": 2, "s8": 1, "u8": 1, "pred": 1}
FLOAT = {
    "add",
    "subtract",
    "multiply",
    "divide",
    "sqrt",
    "rsqrt",
    "maximum",
    "minimum",
    "abs",
    "negate",
    "power",
    "floor",
}
FLOAT |= {"log", "log-plus-one", "exponential", "exponential-minus-one", "sine", "cosine", "tanh", "round-nearest-even"}
WHOLE = {
    "add",
    "subtract",
    "multiply",
    "xor",
    "and",
    "or",
    "shift-left",
    "shift-right-logical",
    "shift-right-arithmetic",
}
FREE = {"parameter", "constant", "tuple", "get-tuple-element", "bitcast", "while", "conditional", "call", "opt-barrier"}
SLICES = {"dynamic-slice", "gather", "slice"}
LINE = re.compile(r"^\s+(?:ROOT )?%([\w.\-]+) = (\([^()]*\)|\S+) ([\w\-]+)\((.*)$")
HEAD = re.compile(r"^(ENTRY )?%([\w.\-]+) .*\{$")


class Counts(NamedTuple):
    """Numbers for one call, or for one lane-tick."""

    flops: float = 0.0
    integer: float = 0.0
    bytes: float = 0.0
    kernels: float = 0.0

    def plus(self, other: "Counts", times: float = 1.0) -> "Counts":
        """Return the sum with `times` the other."""
        return Counts(*(a + times * b for a, b in zip(self, other, strict=True)))


class Instruction(NamedTuple):
    """One line of HLO."""

    name: str
    type: str
    op: str
    rest: str  # operands and attributes

    @property
    def size(self) -> int:
        """Number of entries of all arrays of the result."""
        return sum(n for _, n in arrays(self.type))

    @property
    def bytes(self) -> int:
        """Bytes of all arrays of the result."""
        return sum(SIZES[kind] * n for kind, n in arrays(self.type))

    @property
    def operands(self) -> list[str]:
        """Names of the operands."""
        return re.findall(r"%([\w.\-]+)", self.rest.split(")")[0])

    def called(self, key: str) -> str:
        """Return the computation of an attribute, or ''."""
        match = re.search(rf"\b{key}=%([\w.\-]+)", self.rest)
        return match.group(1) if match else ""


def arrays(type_: str) -> list[tuple[str, int]]:
    """Return kind and number of entries of each array of a type."""
    found = re.findall(r"(\w+)\[([\d,]*)\]", type_)
    return [(kind, int(np.prod([int(d) for d in dims.split(",") if d]))) for kind, dims in found if kind in SIZES]


def count(text: str, trips: list[float]) -> Counts:
    """Return the counts of one call of a program."""
    computations: dict[str, list[Instruction]] = {}
    name = entry = ""
    for line in text.splitlines():
        if head := HEAD.match(line):
            name = head.group(2)
            computations[name] = []
            entry = name if head.group(1) else entry
        elif match := LINE.match(line):
            computations[name].append(Instruction(*match.groups()))
    remaining = iter(trips)
    total = _computation(computations, entry, remaining)
    if (left := list(remaining)) or not total.flops:
        raise ValueError(f"hlo_counts: got {len(left)} numbers of loop runs too many, expected one for each loop")
    return total


def _computation(all_: dict[str, list[Instruction]], name: str, trips: Iterator[float]) -> Counts:
    total, known = Counts(), {i.name: i for i in all_[name]}
    for i in all_[name]:
        if i.op == "while":
            match = re.search(r'known_trip_count":\{"n":"(\d+)', i.rest)
            times = float(match.group(1)) if match else next(trips)
            total = total.plus(_computation(all_, i.called("body"), trips), times)
        elif i.op == "conditional":
            match = re.search(r"branch_computations=\{([^}]*)\}", i.rest)
            branches = (
                match.group(1) if match else " ".join(re.findall(r"(?:true|false)_computation=(%[\w.\-]+)", i.rest))
            )
            total = total.plus(max(_computation(all_, b, trips) for b in re.findall(r"%([\w.\-]+)", branches)))
        elif i.op == "call":
            total = total.plus(_computation(all_, i.called("to_apply"), trips))
        elif i.op not in FREE:
            fused = all_.get(i.called("calls"), [])
            total = total.plus(Counts(*_operations(fused or [i], known), _bytes(i, fused, known), float(i.size > 1)))
    return total


def _operations(instructions: list[Instruction], outside: dict[str, Instruction]) -> tuple[float, float]:
    """Return flops and integer operations of a kernel."""
    known = outside | {i.name: i for i in instructions}
    flops = integer = 0.0
    for i in instructions:
        is_float = i.type.startswith(("f64", "f32"))
        if i.op in FLOAT and is_float:
            flops += i.size
        elif i.op in WHOLE and not is_float and not i.type.startswith("pred"):
            integer += i.size
        elif i.op == "reduce":
            flops += known[i.operands[0]].size
        elif i.op == "dot":
            flops += 2 * i.size * _contracted(i, known[i.operands[0]])
    return flops, integer


def _contracted(dot: Instruction, left: Instruction) -> int:
    """Return the number of products per entry of a matrix product."""
    shape = re.findall(r"\d+", left.type.partition("[")[2].partition("]")[0])
    match = re.search(r"lhs_contracting_dims=\{([\d,]*)\}", dot.rest)
    return int(np.prod([int(shape[int(d)]) for d in match.group(1).split(",") if d])) if match else 1


def _bytes(kernel: Instruction, fused: list[Instruction], known: dict[str, Instruction]) -> float:
    """Return the bytes that a kernel reads and writes."""
    total = float(kernel.bytes)
    inside = {i.name: i for i in fused}
    updated = {i.operands[0] for i in fused if i.op == "dynamic-update-slice"}
    if kernel.op == "dynamic-update-slice" or updated:  # written in place
        root = [
            inside[i.operands[1]].bytes for i in fused if i.op == "dynamic-update-slice" and i.operands[1] in inside
        ]
        total = float(sum(root) or known[kernel.operands[1]].bytes)
    parameters = {i.rest.split(")")[0]: i.name for i in fused if i.op == "parameter"}
    for number, name in enumerate(kernel.operands):
        users = [i for i in fused if parameters.get(str(number)) in i.operands]
        sliced = users and all(i.op in SLICES | {"dynamic-update-slice"} for i in users)
        if sliced:
            total += sum(i.bytes for i in users if i.op in SLICES)
        elif name in known and kernel.op not in SLICES:
            total += known[name].bytes
    return total


class Core(NamedTuple):
    """What a core can do."""

    gflops: float  # products and sums of a matrix product of 256 x 256, 1e9 per second
    l1: float  # bytes per nanosecond of a = b s + c in 24 KiB
    l2: float  # in 960 KiB


@numba.njit
def _triad(a, b, c, s, times):
    for _ in range(times):
        for i in range(len(a)):
            a[i] = b[i] * s + c[i]


def core() -> Core:
    """Measure one core, by its processor time; best of five."""
    A, B, out = np.random.default_rng(0).random((3, 256, 256))

    def bandwidth(n: int, times: int) -> float:
        a, b, c = np.ones((3, n))
        _triad(a, b, c, 1.1, 1)
        return 24 * n * times / best(lambda: _triad(a, b, c, 1.1, times))

    products = 2 * 256**3 * 30 / best(lambda: [np.matmul(A, B, out=out) for _ in range(30)])
    return Core(products, bandwidth(1_000, 40_000), bandwidth(40_000, 1_000))


def best(work: Callable[[], object]) -> float:
    """Return the least processor time of five calls [ns]."""
    times = []
    for _ in range(5):
        start = process_time()
        work()
        times.append(process_time() - start)
    return 1e9 * min(times)
