"""The record of a proof of a gain: the inequality, its margin, the solver. Each theorem's `certify` does the check in float64.

`certified` refuses a margin that is too small; `uncertified` is of gains that nothing proves; `is_certified` says which it is.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.errors import DesignError, UserError

SHORT = 1e-5  # part of a rate asked for that a proof may fall short of it: an optimum lies on the boundary
UNCERTIFIED = "uncertified"  # a status
NO_GAIN = "none: no gain"  # an inequality: there is nothing to prove
NO_NOISE = 1e-12  # variance taken where a scenario has no measurement noise


def power_of_2(many: int) -> int:
    """Return the least power of 2 that is not below `many`, or 0 for 0: few sizes, few programs."""
    return 1 << (many - 1).bit_length() if many else 0


class Certificate(NamedTuple):
    """The inequality that was checked again, the gain's margin in it, and the solver that found the gain."""

    inequality: str
    margin: float  # > 0: certified; inf: nothing was to be proven, as the inequality says
    solver: str
    status: str
    numbers: Mapping[str, Any] = MappingProxyType({})  # matrices and rates worth showing, by name
    rate: float = float("nan")  # [1/s] the decay of the error that is promised, without noise; NaN: none is
    fallback: str = ""  # why the first solver's answer was not taken; empty: it was, or there was no solver


class Design(NamedTuple):
    """An observer's numbers with their proof."""

    gains: Any
    certificate: Certificate
    # whether its prediction to now carries the unknown input it has found; None: no such
    predicts_unknown_input: bool | None = None


class DesignContext(NamedTuple):
    """What an observer is designed with at a grid point. n states, m inputs, q outputs."""

    scenario: str
    model: Model  # nominal
    dt: float  # [s]
    ticks: int  # horizon N
    period: tuple[int, ...]  # [q] ticks; the mean where intervals vary
    delay: tuple[int, ...]  # [q] ticks, as the observer believes it; the mean where it varies
    noise_std: tuple[float, ...]  # [q] of one sample, as designers assume it
    P0: np.ndarray  # [n, n] prior covariance of x(0) about xhat(0)
    input_intensity: float  # process noise through the input that a designer assumes, per second
    noise_correlation: tuple[tuple[float, ...], ...] = ()  # [q, q] between channels; empty: they are independent
    sensors: int = 1  # groups of channels whose samples are taken, delayed and lost together
    overtaking: int = 0  # K: how many newer samples may arrive before one
    spare: int = 0  # K that there is room for at least, so that cells share programs
    # [n] of a tick's noise as assumed, or a root [n, n] of its covariance; empty: none
    process_std: tuple[float, ...] | tuple[tuple[float, ...], ...] = ()
    error: int = 0  # [ticks] the believed delay less the true one
    reach: int = 0  # [samples] the longest delay; it, `overtaking` and `flight` are the most of a study's cells
    flight: int = 1  # [samples] how many can be on their way at once, the one that is taken now too
    latest: int = 0  # [ticks] the greatest age with which a sample can arrive, as the observer believes it
    unknown_std: tuple[float, ...] = ()  # [s] typical size of the unknown inputs or parameters
    unknown0: tuple[float, ...] = ()  # [s] what observers take for the unknowns at the start
    unknown_range: tuple[tuple[float, float], ...] = ()  # [s] where they look for them
    # (now, x[n], unknowns[s]) -> dx/dt[n], where the model is not linear
    field: Callable[..., Any] | None = None
    # (u[m], x[2d]) -> a[d], phi[d] of accelerations a p + phi, where the plant is such a chain
    parts: Callable[..., tuple[Any, Any]] | None = None
    variant: Any = None  # (parameters by name) -> the Model with those; raises UserError for a name that is none
    # (now, x[n], unknowns[s]) -> x[n] one tick later, where the plant is given so
    successor: Callable[..., Any] | None = None
    sensor: Callable[..., Any] | None = None  # (now, x[n], unknowns[s]) -> y[q]; None: the model's
    # (y[q], yhat[q]) -> y less yhat, where outputs wrap; None: their difference
    residual: Callable[..., Any] | None = None
    xhat0: tuple[float, ...] = ()  # [n] the estimate at t = 0, where it is the same in all runs
    intervals: tuple[int, ...] = ()  # every interval [ticks] between samples of a shared clock; empty: the period alone

    @property
    def noise_variance(self) -> np.ndarray:
        """Variance of one sample of each channel, [q]; where there is none NO_NOISE, so that nothing is divided by 0."""
        return np.array([std**2 or NO_NOISE for std in self.noise_std])

    @property
    def noise_covariance(self) -> np.ndarray:
        """Covariance of one sample's noise, [q, q]."""
        size = np.sqrt(self.noise_variance)
        return np.outer(size, size) * (
            np.array(self.noise_correlation) if self.noise_correlation else np.eye(len(size))
        )

    @property
    def process_noise(self) -> np.ndarray:
        """Covariance [n, n] of the noise added to the state at every tick."""
        S = np.asarray(self.process_std, float)
        if not S.size:
            return np.zeros_like(self.P0)
        return S @ S.T if S.ndim == 2 else np.diag(np.square(S))

    def roomier(self, other: "DesignContext") -> "DesignContext":
        """Return the same with as much room for samples as another has, where that is more."""
        most = {name: max(getattr(self, name), getattr(other, name)) for name in ("overtaking", "reach", "flight")}
        return self._replace(**most)

    @property
    def room(self) -> np.ndarray:
        """Room [K] for the samples that may be overtaken (`protocols.Room`)."""
        return np.zeros(max(self.overtaking, self.spare))


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
    """Make the certificate of gains without a proof.

    Args:
        why: the reason, which tables and `design` show.

    Returns:
        A certificate that is not certified.
    """
    return Certificate(inequality=f"none: {why}", margin=float("inf"), solver="none", status=UNCERTIFIED)


def is_certified(fields: Mapping[str, Any]) -> bool | None:
    """Say whether a certificate, as its fields by name, proves its gains; None: there are no gains.

    A margin of infinity (in files: none) has proven nothing.
    """
    if fields["inequality"] == NO_GAIN:
        return None
    margin = fields["margin"]
    return bool(fields["status"] != UNCERTIFIED and margin is not None and 0 < margin < float("inf"))


def least_eigenvalue(M: np.ndarray) -> float:
    """Return the smallest eigenvalue of the symmetric part of M; NaN where M is not finite."""
    return float(np.linalg.eigvalsh((M + M.T) / 2)[0]) if np.isfinite(M).all() else float("nan")


def one_clock(setting: DesignContext, observer: str) -> int:
    """Return the (mean) period in ticks of the clock that all channels share, or say that this observer needs it."""
    if len(set(setting.period)) > 1 or len(set(setting.delay)) > 1:
        raise UserError(
            f"observer {observer} in {setting.scenario}: got channels with periods {setting.period} and delays "
            f"{setting.delay} (ticks), expected one period and one delay for all; give equal ones or leave "
            f"{observer} out."
        )
    return setting.period[0]
