"""Compare the printed numbers and claims of papers, and of standard examples of the field, with computed results."""

from collections.abc import Callable

from pcbench.papers import arm, cart, chain, field, helicopter, pi_pco
from pcbench.papers.claim import Claim

PAPERS: dict[str, tuple[str, Callable[[], list[Claim]]]] = {
    "arm": (
        "Peng, Appl. Sci. 7 (2017) 67: sliding-mode and PI observers with an unknown input, on a flexible-joint arm",
        arm.claims,
    ),
    "cart": (
        "Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017): PCCEBO against KFBO on a mobile cart",
        cart.claims,
    ),
    "chain": (
        "Alipouri, Zhong, Actuators 10 (2021) 281: a chain of observers for unequal delays, on the stirred tank heater",
        chain.claims,
    ),
    "helicopter": (
        "Hernandez-Gonzalez et al., Aerospace 11 (2024) 206: a high-gain observer with delayed samples, on a helicopter",
        helicopter.claims,
    ),
    "pi-pco": ("Li, Wang, Tian: PI-PCO against PCO on a mobile cart, variable sampling", pi_pco.claims),
    "field": (
        "Standard examples of the field: numbers seen in public sources [S], or computed by an independent program [V]",
        field.claims,
    ),
}
