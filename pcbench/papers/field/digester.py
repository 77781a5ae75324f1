"""The digester: its equilibria, and the abstract's statements on delay, initial state, mismatch, noise and tuning.

The abstract was seen; the text and its tables were not obtained. The statements are tested on `digester/multirate`, which has
the equations and constants of an earlier program. An error is the root mean square over the twelve states and the runs after
two days, each state relative to its equilibrium; in per cent.
"""

import numpy as np

from pcbench import api
from pcbench.papers.claim import OPEN, Claim, digits, statement
from pcbench.plants import digester
from pcbench.toml_text import TomlTable

RUNS = 24
HOUR = 3600.0  # s
ABSTRACT = "Hellmann et al. 2025 [S]"
COMPUTED = "Hellmann et al. 2025, program [V]"
NOISE = (4.8, 0.002, 0.002, 0.12, 0.0173, 0.0031)
INFLATED = (1.5, 1.5, 1.5, 7500.0, 750.0, 1.5)  # of the variances, in the program
SLOWER = {"kF": 0.2, "kS": 0.02, "kp": 0.16, "kl": 0.08}  # 1/d, four fifths of what the filter assumes
SITUATIONS: dict[str, TomlTable] = {
    "usual": {},
    "no delay": {"delay": [0.0] * 6},
    "42 h": {"delay": [0.0] * 3 + [42 * HOUR] * 3},
    "right start": {"xhat0": [0.0] * 12},
    "slower": {"parameters": SLOWER},
    "twice the noise": {"noise_std": [2 * std for std in NOISE]},
    "inflated": {"options": {"ekf": {"R": [factor * std**2 for factor, std in zip(INFLATED, NOISE, strict=True)]}}},
}


def rows() -> list[Claim]:
    """Return every claim on the digester; takes a minute."""
    return [*_equilibrium(), *_statements()]


def _equilibrium() -> list[Claim]:
    n = digester.Numbers()
    x, feed = digester.operating_point("printed")
    q, _ = digester.outflow(n, x)
    quantities = (
        ("gas flow", "L/d", "240.97", q),
        ("methane", "bar", "0.5954", digester.RT_CH4 * x[10]),
        ("carbon dioxide", "bar", "0.4224", digester.RT_CO2 * x[11]),
        ("biomass", "g/L", "0.4048", x[8]),
    )
    return [
        digits(f"{quantity} at rest under {feed:.2f} L/d [{unit}]", printed, value)._replace(source=COMPUTED)
        for quantity, unit, printed, value in quantities
    ]


def _statements() -> list[Claim]:
    base: TomlTable = {"base": "digester/multirate"}
    study: TomlTable = {
        "name": "digester-claims",
        "scenarios": {name.replace(" ", "-"): base | changes for name, changes in SITUATIONS.items()},
        "observers": ["ekf"],
        "seeds": RUNS,
    }
    runs = api.run(study).runs
    level = dict(zip((name for name, _ in digester.SIGNALS), digester.operating_point("slow")[0], strict=True))
    square = runs.assign(part=runs.steady_mse / runs.signal.map(level) ** 2).groupby("scenario").part.mean()
    error = {name: 100 * float(np.sqrt(square[name.replace(" ", "-")])) for name in SITUATIONS}
    usual, start, slower = error["usual"], error["right start"], error["slower"]
    none, longer, noise = error["no delay"], error["42 h"], error["twice the noise"]
    by_start, by_slower, by_noise = usual / start, slower / usual, noise / usual
    by_delay = f"ekf: {none:.1f} % without a delay, {usual:.1f} % at 21 h, {longer:.1f} % at 42 h"
    by_cause = f"factors: {by_start:.1f} by the wrong start, {by_slower:.2f} by slower rates, {by_noise:.2f} by twice the noise"
    larger = f"factor {error['inflated'] / usual:.2f} by the program's larger R, less than by the start"
    tuned = f"{larger}; which tuning is meant is in the text"
    return [
        statement(
            "the length of the delay matters little",
            "while observability is kept",
            by_delay,
            max(usual, longer) < 1.05 * none,
        )._replace(source=ABSTRACT),
        statement(
            "wrong start and model mismatch matter more than noise",
            "they do",
            by_cause,
            min(by_start, by_slower) > by_noise,
        )._replace(source=ABSTRACT),
        Claim("tuning matters most", "it does", tuned, OPEN, source=ABSTRACT),
    ]
