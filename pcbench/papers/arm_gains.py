"""The arm's printed gains beside the optima of their LMIs, what they prove, and the constants of the robust terms.

Source: Peng, Appl. Sci. 2017, 7(1), 67, (4), (22) to (24), (38), (52) and section 4. Signs are lost in the text at hand, so
printed entries are compared by size.
"""

from math import pi
from typing import Any

import numpy as np

from pcbench import api
from pcbench.dynamics.observability import shown
from pcbench.observers import pio, smo
from pcbench.papers.claim import MISPRINT, REPRODUCED, Claim, found, rounds_to, statement
from pcbench.plants import arm
from pcbench.scenarios import SCENARIOS
from pcbench.synthesis import pi_lmi, sliding_mode
from pcbench.synthesis.unknown_input import Split, split, unmovable

WHERE = "reproduce arm"
NEAR = 2.0  # per cent of the largest entry that a printed gain may be off its optimum: their solver's, not ours
SHORT_OF = 0.5  # per cent that an objective may be
ROUNDED = 5e-3  # part of the rate that rounding to four decimals may cost
PARTS = {
    "A11": "0 0 3.7500 0.0013",
    "A12": "0 1.0000 3.7500 0",
    "A21": "0 1.0000 3.7500 0",
    "A22": "0 0 3.7500 0.0015",
    "Tp": "0 1.0 1.0 0",
}
LINK = "0 1.0000 3.7500 0.0013"


def claims() -> list[Claim]:
    """Return the printed gains and constants against what comes out."""
    return [*_printed_parts(), *_gains(), *_constants()]


def parts() -> Split:
    """Return the arm in the coordinates that its unknown input reaches last."""
    return split(arm.nominal(arm.Numbers()), WHERE)


def _gains() -> list[Claim]:
    """The printed gains, what they prove, and the optima of the LMIs that they are said to be."""
    plant, out = parts(), []
    best, proof = sliding_mode.solve(plant, 1.0, WHERE), sliding_mode.certify(smo.PRINTED, plant).numbers
    out.append(_objective("SMO gains: least r of (23), (24)", proof["r"], best.r))
    for name in ("L1", "P1", "P2", "A22s"):
        out.append(_beside(f"SMO {name}", getattr(smo.PRINTED, name), getattr(best, name)))
    rate = f"{proof['rate_proven']:.6f} 1/s"
    out.append(statement("SMO gains prove alpha = 1", "1", rate, proof["rate_proven"] >= 1))
    L1 = smo.PRINTED.L1
    optimum, given = pi_lmi.solve(plant, L1, 1.0, WHERE), pi_lmi.certify(pio.PRINTED, plant, L1).numbers
    out.append(_objective("PIO gains: least g of (38), (52) with the printed L1", given["g"], optimum.g))
    for name in ("KP", "KI"):
        out.append(_beside(f"PIO {name}", getattr(pio.PRINTED, name), getattr(optimum, name)))
    rate, short = f"{given['rate_proven']:.6f} 1/s", given["rate_proven"] > 1 - ROUNDED
    out.append(statement("PIO gains prove beta = 1, but for their rounding", "1", rate, bool(short)))
    own = pi_lmi.solve(plant, best.L1, 1.0, WHERE).g
    return [*out, found("PIO: least g with the optimal L1", f"{own:.6g}")]


def _objective(claim: str, printed: float, best: float) -> Claim:
    above = 100 * (printed / best - 1)
    text = f"{printed:.6g} as printed, the optimum is {best:.7g}: {above:.2f} % above it"
    return statement(claim, "least", text, bool(abs(above) < SHORT_OF))


def _beside(claim: str, printed: Any, best: Any) -> Claim:
    """A printed matrix beside the optimum, with how far it is off in parts of its largest entry."""
    off = 100 * np.abs(np.asarray(printed) - best).max() / np.abs(best).max()
    text = f"{_entries(best)} at the optimum: {off:.1f} % off, as a solver's default accuracy leaves it"
    return statement(claim, _entries(printed, 5), text, bool(off < NEAR))


def _entries(M: Any, many: int = 4) -> str:
    return "; ".join(" ".join(f"{0.0 if abs(v) < 1e-4 else v:.{many}g}" for v in row) for row in np.asarray(M))


def _printed_parts() -> list[Claim]:
    """The arm in the coordinates of (4), as printed after its signs were lost."""
    plant, out = parts(), []
    for name, printed in PARTS.items():
        words, values = printed.split(), np.abs(np.asarray(getattr(plant, name))).ravel()
        same = all(rounds_to(word, value) for word, value in zip(words, values, strict=True))
        text = " ".join(f"{value:.6g}" for value in values)
        out.append(statement(f"|{name}| of (4)", printed, text, same))
    link = split(arm.nominal(arm.Numbers())._replace(C=np.eye(4)[:2]), WHERE).A11
    same = all(rounds_to(w, v) for w, v in zip(LINK.split(), np.abs(link).ravel(), strict=True))
    text = " ".join(f"{v:.6g}" for v in np.abs(link).ravel())
    out.append(statement("|A11| with both sensors on the link", LINK, text, same))
    free = unmovable(plant)
    text = f"{len(free)} modes that no L1 moves"
    out.append(statement("(A11, A211) is observable with these sensors", "fully observable", text, not len(free)))
    P = pio.PRINTED.P
    beta = pi_lmi.certify(pio.PRINTED, plant, smo.PRINTED.L1).numbers["rate_proven"]
    largest = float(np.linalg.eigvalsh(P).min())
    text = f"positive definite (least eigenvalue {largest:.4f}), proves {beta:.4f} 1/s beside KP, KI"
    out.append(statement("PIO P", "a certificate", text, largest > 0 and bool(beta > 1 - ROUNDED)))
    return out


def _constants() -> list[Claim]:
    """What the paper says of its robust terms, and the modes with both sensors on the link."""
    delta = arm.Numbers().M * arm.Numbers().g * arm.Numbers().l / arm.Numbers().J
    left = {name: 1 - delta - size for name, size in (("d1", 0.25), ("d2", 0.35))}
    text = f"{1 - delta:.2f} without d; {left['d1']:.2f} with d1, {left['d2']:.2f} with d2"
    trace, falls = api.simulate("arm/sine", ["smo"]), api.simulate("arm/sawtooth", ["smo"]).input
    rate = delta * (trace.link_velocity * np.cos(trace.link_angle)).abs().max() + 0.25 * 2 * pi
    jump, step = falls.diff().abs().max(), SCENARIOS["arm/sawtooth"].dt
    model = arm.nominal(arm.Numbers())
    fixed = unmovable(split(model._replace(C=np.eye(4)[:2]), WHERE))
    modes = ", ".join(map(shown, fixed))
    return [
        statement("|f| <= delta without d", "0.1103", f"delta = {delta:.5f}, to 4 digits", rounds_to("0.1103", delta)),
        statement("rho = 1 leaves eta = 0.89 (22)", "0.89", text, min(left.values()) > 0.885),
        statement("zeta = 1.8 bounds f' under d1 (38)", "1.8", f"at most {rate:.2f}", bool(rate <= 1.8)),
        statement(
            "zeta = 1.8 bounds f' under d2 (38)",
            "1.8",
            f"d jumps by {jump:.2g}",
            bool(jump < 1.8 * step),
        ),
        Claim(
            "modes with both sensors on the link, which no L1 moves",
            "-0.006 +- 1.9365j (sign restored)",
            modes,
            REPRODUCED if abs(fixed[0].real + 0.006) < 5e-4 else MISPRINT,
        ),
    ]
