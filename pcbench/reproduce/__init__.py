"""Each paper's printed numbers and claims against what comes out here, line by line."""

from collections.abc import Callable

from pcbench.reproduce.claim import Claim
from pcbench.reproduce.mobile_cart import claims as cart

PAPERS: dict[str, tuple[str, Callable[[], list[Claim]]]] = {
    "cart": (
        "Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017): PCCEBO against KFBO on a mobile cart",
        cart,
    ),
}
