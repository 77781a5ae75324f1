"""A study's own linear plant, `[lti]`: matrices with the experiment on them, checked and turned into a scenario."""

import re
from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationInfo

from pcbench.errors import UserError, short, shown, unknown
from pcbench.scenarios import Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.signals import SIGNALS, SINGLE
from pcbench.study import axes, limits

LEAST = 1e-100  # a number is 0 or no smaller: its square can be told from 0
# powers of ten by which a plant may grow over its horizon: powers of its map, up to the eighth, stay finite
GROWTH = 30
MOST = 50  # states, inputs, outputs or unknown inputs


def _told_from_zero(number: float) -> float:
    if 0 < abs(number) < LEAST:
        raise ValueError(f"0 or a number of at least {LEAST:g} in size")
    return number


Bounded = Annotated[float, Strict(), Field(ge=-axes.LARGEST, le=axes.LARGEST)]  # Strict: no text, no true or false
Number = Annotated[Bounded, AfterValidator(_told_from_zero)]
Positive = Annotated[Number, Field(ge=axes.SMALLEST)]
Size = Annotated[Number, Field(ge=0)]


def _rows(given: Any, info: ValidationInfo) -> Any:
    """Say how a list of numbers stands as a matrix: a column for each input, a row for each output."""
    if isinstance(given, list) and given and not any(isinstance(each, list) for each in given):
        rows = [[each] for each in given] if info.field_name in ("B", "E") else [given]
        raise ValueError(f"a list of rows; write {rows}")
    return given


Rows = Annotated[list[list[Number]], BeforeValidator(_rows)]
PerChannel = Number | list[Number]


class Lti(BaseModel):
    """x' = A x + B u + E f, y = C x + D u, u and f held over a tick; with `dt`, x one tick later. n, m, q; r unknown inputs."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    A: Rows = Field(description="[n, n]")
    B: Rows = Field(description="[n, m]")
    C: Rows = Field(description="[q, n]")
    D: Rows | None = Field(None, description="[q, m]; left out: zero")
    E: Rows | None = Field(None, description="[n, r] how an unknown input enters; left out: there is none")
    dt: Positive | None = Field(None, description="tick of a discrete plant [s]; left out: a continuous plant")
    tick: Positive | None = Field(None, description="tick of the simulation [s]; default 0.001, or dt")
    states: list[str] | None = Field(None, description='names with units, such as "angle [rad]"')
    sampling_period: PerChannel = Field(description="[s], one or one for each output")
    delay: PerChannel | str = Field(description="[s], one or one for each output, or 'interval'")
    noise_std: PerChannel = Field(description="of one sample, one or one for each output")
    input: str = Field("sine", description="a signal's name for all inputs, or one for each, with commas")
    unknown_input: str | None = Field(
        None, description="a signal's name for all, or one for each, with commas; default: sine"
    )
    unknown_std: list[Number] | None = Field(None, description="[r] its typical size; default: ones")
    x0: list[Number] | None = Field(None, description="[n] default: ones")
    xhat0: list[Number] | None = Field(None, description="[n] default: zeros")
    prior_std: list[Size] | None = Field(None, description="[n] of x(0) about xhat(0); default: |x0 - xhat0|, or 1")
    settle_band: list[Size] | None = Field(
        None, description="[n] default: 5 % of prior_std and unknown_std; [n + r] with E"
    )
    bound: Positive = Field(1e6, description="a run has diverged when an |e| leaves it")
    horizon: Positive = Field(10.0, description="[s]")
    tail: Size | None = Field(None, description="where the tail starts [s]; default: 30 % of the horizon")
    observers: list[str] = Field(["dkf", "open-loop"], min_length=1)
    profile: str | list[Number] = "periodic"
    jitter: Number = 0.0
    delay_jitter: Number = 0.0
    loss: Number = 0.0

    def scenario(self, name: str, where: str) -> Scenario:
        """Return the experiment as a scenario; raise UserError naming the key that does not fit."""
        n, m, q = _shapes(self, where)
        if self.dt is not None and self.tick not in (None, self.dt):
            raise UserError(
                f"{where}: got a discrete plant of dt = {self.dt:g} s and a tick of {self.tick:g} s, expected the same; "
                f"leave tick out, or discretise the plant at {self.tick:g} s."
            )
        r = len(self.E[0]) if self.E else 0
        signals = _named(self.input, SIGNALS, m, "inputs", f"{where}.input")
        if self.unknown_input is not None and not r:
            raise UserError(
                f"{where}.unknown_input: got {shown(self.unknown_input)} without E, expected E [n, r] beside it."
            )
        pushing = (
            _named(self.unknown_input or "sine", SINGLE, r, "unknown inputs", f"{where}.unknown_input") if r else []
        )
        x0, xhat0 = _vector(self.x0, 1.0, n, f"{where}.x0"), _vector(self.xhat0, 0.0, n, f"{where}.xhat0")
        apart = [abs(a - b) or 1.0 for a, b in zip(x0, xhat0, strict=True)]
        prior = _vector(self.prior_std, apart, n, f"{where}.prior_std")
        size = _vector(self.unknown_std, 1.0, r, f"{where}.unknown_std", "unknown input")
        if any(one < axes.SMALLEST for one in size):
            raise UserError(
                f"{where}.unknown_std: got {shown(size)}, expected sizes greater than 0; write how large the input is."
            )
        band = [0.05 * p for p in [*prior, *size]]
        tail = 0.3 * self.horizon if self.tail is None else self.tail
        tick = self.dt or self.tick or 1e-3
        ticks = limits.ticks_of(self.horizon, tick, where)
        unknowns = tuple(("input" if r == 1 else f"input{i + 1}", "1") for i in range(r))
        states = _signals(self.states, n, f"{where}.states")
        for signal, _ in unknowns:
            if signal in dict(states):
                raise UserError(
                    f"{where}.states: got a state called '{signal}', expected another name (the unknown input has it)."
                )
        _require_slow(self, ticks, tick, where)
        base = Scenario(
            name=name,
            summary="a plant of one's own",
            source="the study",
            plant="lti",
            observers=tuple(self.observers),
            truth=Truth(x0=tuple(x0), unknown_input=", ".join(pushing)),
            loop=Loop(input=", ".join(signals)),
            sampling=Sampling(sampling_period=(tick,) * q, delay=(0.0,) * q, noise_std=(0.0,) * q),
            belief=Belief(
                xhat0=tuple(xhat0),
                prior_std=tuple(prior),
                model={key: getattr(self, key) for key in "ABCDE"} | {"discrete": self.dt is not None},
                unknown_std=tuple(size),
            ),
            scoring=Scoring(
                settle_band=tuple(_vector(self.settle_band, band, n + r, f"{where}.settle_band", "signal")),
                bound=self.bound,
                tail=round(tail / tick) * tick,
                signals=states,
                unknowns=unknowns,
                headline=(states[0][0], *(name for name, _ in unknowns)) if r else (),
            ),
            dt=tick,
            horizon=ticks * tick,
        )
        if not 0 <= base.scoring.tail < base.horizon:
            raise UserError(f"{where}.tail: got {tail:g} s, expected less than the horizon of {self.horizon:g} s.")
        given = {f: getattr(self, f) for f in axes.AXES if f in type(self).model_fields}
        return base.having(**{f: axes.point(f, v, base, f"{where}.{f}") for f, v in given.items()})


def _shapes(lti: Lti, where: str) -> tuple[int, int, int]:
    """Return n, m, q; raise UserError naming the matrix whose shape does not fit."""
    n, m, q, r = len(lti.A), len((lti.B or [[]])[0]), len(lti.C), len((lti.E or [[]])[0])
    shapes = {"A": (n, n), "B": (n, m), "C": (q, n), "D": (q, m), "E": (n, max(r, 1))}
    if max(n, m, q, r) > MOST:
        raise UserError(
            f"{where}: got {n} states, {m} inputs, {q} outputs and {r} unknown inputs, expected at most {MOST} of each; reduce "
            "the model."
        )
    for name, shape in shapes.items():
        rows = getattr(lti, name)
        if rows is None:
            continue
        lengths = [len(row) for row in rows]
        widths = sorted(set(lengths)) or [0]
        if 0 in shape or len(rows) != shape[0] or widths != [shape[1]]:
            got = f"{len(rows)} x {widths[0]}" if len(widths) == 1 else f"rows of lengths {shown(lengths)}"
            raise UserError(
                f"{where}.{name}: got {got}, expected {max(shape[0], 1)} x {max(shape[1], 1)} ({n} states, {m} inputs, "
                f"{q} outputs" + (f", {r} unknown inputs)." if lti.E is not None else ").")
            )
    return n, m, q


def _require_slow(lti: Lti, ticks: int, tick: float, where: str) -> None:
    """Raise UserError where the plant grows so much over its horizon that its map cannot be computed."""
    modes = np.linalg.eigvals(np.array(lti.A, float))
    rate = float(np.log10(max(np.abs(modes).max(), LEAST)) if lti.dt else modes.real.max() * tick / np.log(10))
    if rate * ticks > GROWTH:
        raise UserError(
            f"{where}.A: got a plant that grows by 1e{rate * ticks:.0f} over the horizon of {ticks * tick:g} s, expected "
            f"at most 1e{GROWTH}; shorten the horizon to {GROWTH / rate * tick:.2g} s."
        )


def _named(text: str, valid: Iterable[str], many: int, what: str, where: str) -> list[str]:
    """The names of signals, one or one for each of `many`."""
    names = [part.strip() for part in text.split(",")]
    for name in names:
        if name not in valid:
            raise unknown(where, "input", name, valid)
    if len(names) not in (1, many):
        raise UserError(f"{where}: got {len(names)} signals, expected one, or one for each of {many} {what}.")
    return names


def _vector(given: list[float] | None, default: Any, n: int, where: str, what: str = "state") -> list[float]:
    if given is None:
        return list(np.broadcast_to(np.asarray(default, float), n))
    if len(given) != n:
        raise UserError(f"{where}: got {len(given)} numbers, expected {n}, one for each {what}.")
    return given


def _signals(states: list[str] | None, n: int, where: str) -> tuple[tuple[str, str], ...]:
    """State names and units from texts such as "angle [rad]"."""
    if states is None:
        return tuple((f"x{i + 1}", "1") for i in range(n))
    if len(states) != n:
        raise UserError(f"{where}: got {len(states)} names, expected {n}, one for each state.")
    out = []
    for text in states:
        found = re.fullmatch(r"\s*([A-Za-z]\w*)\s*(?:\[([^\]]+)\])?\s*", text)
        if not found:
            raise UserError(f"{where}: got '{short(text)}', expected a name with a unit, such as 'angle [rad]'.")
        out.append((found[1], found[2] or "1"))
    names = [name for name, _ in out]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{where}: got '{short(name)}' twice, expected each once; rename one.")
    return tuple(out)
