"""Each paper's printed numbers and claims against what comes out here, line by line."""

from collections.abc import Callable

from pcbench.reproduce import helicopter, mobile_cart, pi_pco, unequal_delays, unknown_input
from pcbench.reproduce.claim import Claim

PAPERS: dict[str, tuple[str, Callable[[], list[Claim]]]] = {
    "arm": (
        "Peng, Appl. Sci. 7 (2017) 67: sliding-mode and PI observers with an unknown input, on a flexible-joint arm",
        unknown_input.claims,
    ),
    "cart": (
        "Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017): PCCEBO against KFBO on a mobile cart",
        mobile_cart.claims,
    ),
    "chain": (
        "Alipouri, Zhong, Actuators 10 (2021) 281: a chain of observers for unequal delays, on the stirred tank heater",
        unequal_delays.claims,
    ),
    "helicopter": (
        "Hernandez-Gonzalez et al., Aerospace 11 (2024) 206: a high-gain observer with late samples, on a helicopter",
        helicopter.claims,
    ),
    "pi-pco": ("Li, Wang, Tian: PI-PCO against PCO on a mobile cart, variable sampling", pi_pco.claims),
}
