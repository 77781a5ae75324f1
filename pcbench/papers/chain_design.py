"""The chain observer's design as printed, entry by entry, and where the print contradicts itself.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5. Signs are lost in the text at hand and T is printed to two or
three digits, so magnitudes are compared, within 6 % or half a unit of the last printed digit. The design follows from the
printed T by (8): L = (T A^d - G T) inv(C), H_i = T A^i B; Q_j = C A^(j-1) B; of V the entries that do not depend on signs, of
C A^d inv(C).
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import MISPRINT, OPEN, REPRODUCED, Claim, unit
from pcbench.plants import csth
from pcbench.synthesis import chain

CLOSE = 0.06


class PrintedChain(NamedTuple):
    """One chain as printed, row by row; chain 3 is said to be the same as chain 1."""

    d: int
    T: str
    entries: dict[str, str]
    V: dict[tuple[int, int], str]


PRINTED = {
    1: PrintedChain(
        2,
        "6.2e-3 2.6e-6 5.7e-6 0.652 6.6e-7 1.2e-6 0.732 2.1e-7 6.7e-7",
        {
            "L": "3e-7 2.3e-6 8.3e-12 1.9e-4 6.7e-2 5.7e-6 0.02 0.0172 1.2e-6",
            "H0": "6.2e-3 0.175 0.652 0.038 0.7323 0.02",
            "H1": "1.6e-3 2.1e-4 4.1e-4 4.5e-5 1.3e-4 2.4e-5",
            "Q1": "31.83 0 0 0 0 30411.5",
            "Q2": "0 0 0.0241 0 0 36.55",
        },
        {(1, 0): "4.5e-6", (1, 1): "3.5e-5", (2, 2): "1.4e-6"},
    ),
    2: PrintedChain(
        3,
        "2.9e-2 3.8e-5 8.2e-11 5.3e-3 9.1e-7 1e-9 4.5e-5 8.7e-8 1.2e-9",
        {
            "L": "2.5e-8 2e-4 1.4e-11 9.2e-4 0.998 8.27e-11 1.6e-4 0.0236 1e-9",
            "H0": "0.0295 2.4e-6 5.3e-3 3e-5 4.6e-5 3.6e-5",
            "H1": "0.0241 3.2e-8 5.7e-4 3.8e-7 5.4e-5 4.6e-7",
            "H2": "1.4e-4 3.1e-7 3e-6 4e-7 6.4e-7 3.3e-7",
            "Q1": "31.83 0 0 0 0 30411.5",
            "Q2": "0 0 0.0241 0 0 36.55",
            "Q3": "0 0 1.4e-4 0 0 0.044",
        },
        {(1, 0): "2.6e-8", (1, 1): "2.1e-7", (2, 2): "1.7e-9"},
    ),
}


GARBLED = {(1, "H0", 0): "6.21.6e-3", (2, "L", 8): "1 x 9"}  # as they stand in the text, for what is read above


def claims() -> list[Claim]:
    """Return the printed design against what follows from it."""
    return [*_entries(), *_misprints(), *_undetermined()]


def designed(printed: PrintedChain) -> dict[str, Matrix]:
    """Return L, H_i, Q_j and V of a chain that follow from its printed T on the plant as printed."""
    A, B, C, *_ = csth.nominal(csth.Numbers(literal=True))
    d, power = printed.d, np.linalg.matrix_power
    T, G = np.array(printed.T.split(), float).reshape(3, 3), chain.companion(1e-4, 3)
    out = {"L": (T @ power(A, d) - G @ T) @ np.linalg.inv(C), "V": C @ power(A, d) @ np.linalg.inv(C)}
    out |= {f"H{i}": T @ power(A, i) @ B for i in range(d)}
    return out | {f"Q{j}": C @ power(A, j - 1) @ B for j in range(1, d + 1)}


def close(word: str, value: float) -> bool:
    """Say whether a printed magnitude is a value's, within 6 % or half a unit of its last digit."""
    return abs(abs(value) - float(word)) <= max(CLOSE * float(word), 0.5 * unit(word))


def _entries() -> list[Claim]:
    out = []
    for number, printed in PRINTED.items():
        found = designed(printed)
        words = {(name, i): word for name, text in printed.entries.items() for i, word in enumerate(text.split())}
        words |= {("V", 3 * i + j): word for (i, j), word in printed.V.items()}
        for (name, i), word in words.items():
            value, wide = abs(found[name].ravel()[i]), found[name].shape[1]
            if float(word) == 0 and value < 1e-12:
                continue
            shown = f"{GARBLED[number, name, i]}, read {word}" if (number, name, i) in GARBLED else word
            verdict = REPRODUCED if close(word, value) else MISPRINT
            digits = max(3, len(word.partition("e")[0].replace(".", "").lstrip("0")))
            claim = f"chain {number}: |{name}({i // wide + 1},{i % wide + 1})|"
            out.append(Claim(claim, shown, f"{value:.{digits}g}", verdict))
    return out


def _misprints() -> list[Claim]:
    """What the print contradicts itself in."""
    wrong = np.abs(np.roots([1, -3e-4, 3e-8, -1e-2])).max()
    poles = f"1e-12: only that has three poles at 1e-4 (1e-2 has one of size {wrong:.3f})"
    heater = f"{csth.Numbers().mc:.9g}: Q1 = C B prints 30411.5"
    return [
        Claim("B(3,2)", "3041.5241", heater, MISPRINT),
        Claim("g_1 of the poles", "10^-2", poles, MISPRINT),
        Claim("Q_0, Q_d of (9) where D != 0", "D - V D, C A^(d-1) B", _feedthrough(), MISPRINT),
    ]


def _feedthrough() -> str:
    """Which coefficients of (9) predict y exactly: a plant with D, xhat exact, one link."""
    rng = np.random.default_rng(5)
    A, B, C, D, V = (rng.standard_normal(shape) for shape in [(3, 3), (3, 1), (2, 3), (2, 1), (2, 2)])
    x, u = rng.standard_normal(3), rng.standard_normal((2, 1))
    y = C @ (A @ x + B @ u[0]) + D @ u[1]
    rest = (C @ A - V @ C) @ x + V @ (C @ x + D @ u[0])
    right = rest + D @ u[1] + (C @ B - V @ D) @ u[0]
    printed = rest + (D - V @ D) @ u[1] + C @ B @ u[0]
    wrong, exact = np.abs(y - printed).max(), np.abs(y - right).max()
    close = "exact" if exact < 1e-12 else f"off by {exact:.0e}"
    return f"D, C A^(d-1) B - V D: {close}; as printed off by {wrong:.2f}"


def _undetermined() -> list[Claim]:
    free = "C is invertible, so any invertible T solves (8): nine free numbers, taken as printed"
    lost = "depends on the signs of T, which are lost"
    return [
        Claim("chains 1, 2: T", "nine numbers each", free, OPEN),
        Claim("chains 1, 2: W, the rest of V", "printed", lost, OPEN),
    ]
