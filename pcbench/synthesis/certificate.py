"""The inputs of a design, and the record of a certificate of its gains: the inequality, its margin, and the solver.

Each theorem's `certify` checks its inequality in float64. `require_certified` rejects a margin that is too small,
`no_certificate` makes the record of gains without a certificate, and `is_certified` distinguishes the two.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.errors import DesignError, UserError

RATE_TOL = 1e-5  # relative tolerance of a certified rate, because an optimum is on the boundary
UNCERTIFIED = "uncertified"  # a status
NO_GAIN = "none: no gain"  # an inequality, of an observer without gains
NO_NOISE = 1e-12  # variance of a sample in a scenario without measurement noise


def power_of_2(n: int) -> int:
    """Return the least power of 2 that is at least n, or 0 for 0; few sizes mean few compiled programs."""
    return 1 << (n - 1).bit_length() if n else 0


class Certificate(NamedTuple):
    """The inequality that was checked again in float64, the margin of the gain, and the solver that found the gain."""

    inequality: str  # the inequality, or the reason why there is none
    margin: float  # certified if greater than 0; inf: there is nothing to certify
    solver: str  # name of the solver
    status: str  # status that the solver returned
    numbers: Mapping[str, Any] = MappingProxyType({})  # matrices and rates of the certificate, by name
    rate: float = float("nan")  # certified decay rate of the error without noise [1/s]; NaN: none
    # why the answer of the first solver was rejected; empty: it was accepted, or no solver was needed
    fallback: str = ""


class Design(NamedTuple):
    """The gains of an observer with their certificate."""

    gains: Any  # arrays that the functions of the observer receive
    certificate: Certificate  # use `no_certificate` if there is none
    # whether the prediction to the present includes the estimated unknown input; None: no input is estimated
    predicts_unknown_input: bool | None = None


class DesignContext(NamedTuple):
    """What a design may use at a grid point: n states, m inputs, q outputs, s unknown inputs or parameters."""

    scenario: str  # name, for error messages
    model: Model  # nominal linear model
    dt: float  # duration of a tick [s]
    ticks: int  # number of ticks of a run
    period: tuple[int, ...]  # mean sampling period [ticks], of each output
    delay: tuple[int, ...]  # mean assumed delay [ticks], of each output
    noise_std: tuple[float, ...]  # assumed standard deviation of the noise of a sample, of each output
    P0: np.ndarray  # prior covariance of x(0) about xhat(0), n by n
    input_intensity: float  # assumed intensity of process noise through the input, per second
    noise_correlation: tuple[tuple[float, ...], ...] = ()  # of the outputs, q by q; empty: independent
    # change of each output from which on its sensor sends a sample; empty: a sample that is not sent contains no information
    send_threshold: tuple[float, ...] = ()
    in_loop: bool = False  # whether a controller computes the input
    sensors: int = 1  # number of sensors: groups of outputs that are sampled, delayed and lost together
    oosm_lag: int = 0  # largest number of newer samples that arrive before an older one
    random_schedule: bool = False  # whether sampling and arrival times differ between runs
    spare: int = 0  # least room for such newer samples, so that grid points share compiled programs
    # assumed noise of a tick: standard deviations of n states, or an n by n root of the covariance; empty: none
    process_std: tuple[float, ...] | tuple[tuple[float, ...], ...] = ()
    error: int = 0  # assumed delay minus true delay [ticks]
    reach: int = 0  # longest delay [samples]; like `oosm_lag` and `flight` the maximum over the grid points
    flight: int = 1  # how many samples can be in transit at once, the one that is taken now included
    latest: int = 0  # greatest age of a sample that arrives, according to its timestamp [ticks]
    unknown_std: tuple[float, ...] = ()  # typical size of each unknown input or parameter
    unknown0: tuple[float, ...] = ()  # initial estimate of each unknown input or parameter
    unknown_range: tuple[tuple[float, float], ...] = ()  # range of each unknown input or parameter
    # (now, x, unknowns) -> dx/dt, if the model is not linear
    field: Callable[..., Any] | None = None
    # (u, x) -> a, phi of accelerations a p + phi with parameters p, if the plant has this form
    parts: Callable[..., tuple[Any, Any]] | None = None
    variant: Any = None  # (parameters by name) -> the model with these parameters
    # (now, x, unknowns) -> x one tick later, if the plant is given by its step
    successor: Callable[..., Any] | None = None
    sensor: Callable[..., Any] | None = None  # (now, x, unknowns) -> y; None: that of the model
    # (y, yhat) -> residual, if outputs wrap around; None: their difference
    residual: Callable[..., Any] | None = None
    xhat0: tuple[float, ...] = ()  # initial estimate, if it is the same in all runs
    intervals: tuple[int, ...] = ()  # all intervals between samples of a shared clock [ticks]; empty: the period

    @property
    def noise_variance(self) -> np.ndarray:
        """Variance of the noise of a sample, of each output; 1e-12 for an output without noise, so that it has an inverse."""
        return np.array([std**2 or NO_NOISE for std in self.noise_std])

    @property
    def noise_covariance(self) -> np.ndarray:
        """Covariance of the noise of a sample, q by q."""
        std = np.sqrt(self.noise_variance)
        return np.outer(std, std) * (np.array(self.noise_correlation) if self.noise_correlation else np.eye(len(std)))

    @property
    def process_noise(self) -> np.ndarray:
        """Covariance of the noise that is added to the state at every tick, n by n."""
        S = np.asarray(self.process_std, float)
        if not S.size:
            return np.zeros_like(self.P0)
        return S @ S.T if S.ndim == 2 else np.diag(np.square(S))

    def roomier(self, other: "DesignContext") -> "DesignContext":
        """Return a copy with at least as much room for samples as another context."""
        sizes = {name: max(getattr(self, name), getattr(other, name)) for name in ("oosm_lag", "reach", "flight")}
        return self._replace(**sizes)

    @property
    def room(self) -> np.ndarray:
        """Room for the newer samples that may arrive before an older one (`protocols.Room`), for `parts/reorder_buffer`."""
        size = max(self.oosm_lag, self.spare)
        return np.zeros(size) if self.random_schedule else np.zeros((size, 1))


def require_certified(certificate: Certificate, where: str, least: float = 0.0) -> Certificate:
    """Check a certificate's margin.

    Args:
        certificate: the certificate.
        where: what is designed and for which scenario, for the error message.
        least: the margin must be greater.

    Returns:
        The certificate.

    Raises:
        DesignError: the margin is not greater than `least`, or is NaN.
    """
    if not certificate.margin > least:
        raise DesignError(
            f"{where}: the gain is not certified: {certificate.inequality} has margin {certificate.margin:.3g}, "
            f"expected above {least:g}; solver {certificate.solver} said '{certificate.status}'; "
            "change the gains, what they are designed from, or the sampling period."
        )
    return certificate


def no_certificate(why: str) -> Certificate:
    """Make the certificate of gains that are not certified.

    Args:
        why: the reason, which tables and `design` show.

    Returns:
        A certificate that is not certified.
    """
    return Certificate(inequality=f"none: {why}", margin=float("inf"), solver="none", status=UNCERTIFIED)


def is_certified(fields: Mapping[str, Any]) -> bool | None:
    """Return whether a certificate, given as a mapping of its fields, certifies its gains; None without gains.

    A margin of infinity (in files: none) certifies nothing.
    """
    if fields["inequality"] == NO_GAIN:
        return None
    margin = fields["margin"]
    return bool(fields["status"] != UNCERTIFIED and margin is not None and 0 < margin < float("inf"))


def least_eigenvalue(M: np.ndarray) -> float:
    """Return the smallest eigenvalue of the symmetric part of M; NaN if M is not finite."""
    return float(np.linalg.eigvalsh((M + M.T) / 2)[0]) if np.isfinite(M).all() else float("nan")


def one_clock(context: DesignContext, observer: str) -> int:
    """Return the (mean) period [ticks] of the clock of all channels; raise UserError if their periods or delays differ."""
    if len(set(context.period)) > 1 or len(set(context.delay)) > 1:
        raise UserError(
            f"observer {observer} in {context.scenario}: got channels with periods {context.period} and delays "
            f"{context.delay} (ticks), expected one period and one delay for all; give equal ones or leave "
            f"{observer} out."
        )
    return context.period[0]
