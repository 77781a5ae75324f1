"""A digester with fast gas sensors and a slow laboratory: the tutorial on multirate extended Kalman filters.

Flow and pressures of the gas are measured every 2 h, in the public program every half hour. Nitrogen, total and volatile solids
are sampled once a day, first after 11 h, and arrive 21 h later. In the program these times are 0.45 d, and 0.8 d plus up to
1/7 d at random, moved to its grid of half hours: 19.5 to 22.5 h.
The plant starts at rest and is fed twice in a week. `printed-feed` has the feed of the program, 1008 and 432 L/d. It replaces
the 100 L of the tank 9 times in a week, which no digester bears. `multirate` has a 24th of it.
The filter assumes the program's process noise, although the plant has none, and P0 = I. Decided here: the estimate starts with
three quarters of the true nitrogen, substrates and biomass; the program draws a random factor for each state.
Source: Hellmann, Wilms, Streif, Weinrich, arXiv 2512.20354, whose text was not obtained. Numbers are those of that program.
"""

from math import sqrt

from pcbench.scenarios.scenario import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.sources import Table

DAY, TICK = 86400.0, 1800.0  # s
PER_DAY = (0.016, 0.555, 0.563, 0.9584, 1.263, 2.816, 2.654, 0.972, 2.894, 0.01, 0.374, 0.948)  # (g/L)^2/d
CHANGES = tuple(DAY * days for days in (0.0, 2.5, 3.0, 5.5, 6.5))  # s


def _feed(first: float, second: float) -> tuple[Table, ...]:
    """Return the feed as its deviation from its mean over the week; the portions in L/d."""
    mean = (first / 2 + second) / 7
    return (Table(CHANGES, tuple((portion - mean,) for portion in (0.0, first, 0.0, second, 0.0))),)


def _initial_deviation(nitrogen: float, substrates: tuple[float, ...]) -> tuple[float, ...]:
    """Return deviations [12]: a quarter less than at rest, of nitrogen and of the substrates and biomass [5]."""
    return (0.0, 0.0, -nitrogen / 4, 0.0, *(-value / 4 for value in substrates), 0.0, 0.0, 0.0)


MULTIRATE = Scenario(
    name="digester/multirate",
    summary="gas every 2 h; laboratory every day, delayed by 21 h",
    source="Hellmann, Wilms, Streif, Weinrich 2025",
    plant="digester",
    observers=("ekf", "kf", "kf-ignore-delay", "model-only"),
    truth=Truth(x0=(0.0,) * 12),
    loop=Loop(input=_feed(42.0, 18.0)),
    sampling=Sampling(
        sampling_period=(4 * TICK,) * 3 + (DAY,) * 3,
        sampling_phase=(0.0,) * 3 + (22 * TICK,) * 3,
        delay=(0.0,) * 3 + (42 * TICK,) * 3,
        noise_std=(4.8, 0.002, 0.002, 0.12, 0.0173, 0.0031),
    ),
    belief=Belief(
        xhat0=_initial_deviation(0.987, (2.16, 8.08, 1.16, 0.507, 2.02)),
        prior_std=(1.0,) * 12,
        assumed_process_std=tuple(sqrt(variance * TICK / DAY) for variance in PER_DAY),
    ),
    scoring=Scoring(
        settle_band=(0.01, 0.05, 0.1, 1.0, 0.5, 1.0, 0.5, 0.2, 0.5, 0.5, 0.01, 0.02),
        divergence_threshold=1e3,
        steady_start=2 * DAY,
        headline=("inorganic_nitrogen", "biomass"),
    ),
    dt=TICK,
    duration=7 * DAY,
)
DIGESTER = (
    MULTIRATE,
    MULTIRATE.with_fields(
        name="digester/printed-feed",
        summary="as multirate, with the larger feed of the public program",
        model={"point": "printed"},
        input=_feed(1008.0, 432.0),
        xhat0=_initial_deviation(0.651, (9.86, 11.5, 4.14, 1.29, 0.405)),
    ),
)
