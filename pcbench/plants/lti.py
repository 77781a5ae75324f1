"""A linear plant: x' = A x + B v + E f, or x one tick later if `discrete`; y = C x + D v, v = gain u + bias.

A, B, C, D, E are given by the user and known to observers. Entries may be formulas of named numbers. The true plant may differ
by `input_gain`, `input_bias`, other values of the named numbers, and `plant`: its own matrices or named numbers, of which
`drift` is the share (1: all of it). Observers do not get the unknown input f (default: none). The output of tick k depends on
the input held from t_k on. A tick is the exact exponential under the held inputs, including f.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from pcbench import expression
from pcbench.dynamics.linear import Matrix, Model, one_tick
from pcbench.protocols import Leaf, Now, Plant
from pcbench.scenarios.scenario import NOTHING
from pcbench.scenarios.signals import inputs

MATRICES = "ABCDE"
Rows = Sequence[Sequence[float | str]] | Matrix  # rows of a matrix; a text is a formula
SIGNALS = ()  # those of the scenario


class Numbers(NamedTuple):
    """The plant; `plant.input_gain` and `plant.input_bias` are axes."""

    A: Rows = ((0.0,),)  # [n, n]
    B: Rows = ((1.0,),)  # [n, m]
    C: Rows = ((1.0,),)  # [q, n]
    D: Rows | None = None  # [q, m]; None: zero
    discrete: bool = False
    input_gain: float = 1.0
    input_bias: float = 0.0  # unit of the input
    drift: float = 0.0  # share of `plant`
    E: Rows | None = None  # [n, r]; None: no unknown input
    unknown_input: str = "zero"  # f: name of a signal for all, or one per input, with commas
    parameters: Mapping[str, float] = NOTHING  # named numbers of the formulas
    formulas: Mapping[str, Rows] = NOTHING  # by letter: matrices with formulas among their entries
    plant: Mapping[str, Any] = NOTHING  # true values that the model does not have: rows by letter, numbers by name


class Params(NamedTuple):
    """One tick and the output; n states, m inputs, q outputs, r unknown inputs (0: none)."""

    Phi: Leaf  # [n, n]
    Gamma: Leaf  # [n, m]
    A: Leaf  # [n, n] of the field
    B: Leaf  # [n, m]
    C: Leaf  # [q, n]
    D: Leaf  # [q, m]
    gain: Leaf
    bias: Leaf
    E: Leaf  # [n, r] of the field
    Gamma_f: Leaf  # [n, r] of one tick
    f: Leaf  # [N+1, r]


def nominal(numbers: Numbers) -> Model:
    """Return the model for designs."""
    rows = {letter: numbers.formulas.get(letter, getattr(numbers, letter)) for letter in MATRICES}
    A, B, C = (evaluate_rows(rows[letter], numbers.parameters) for letter in "ABC")
    D, E = (None if rows[letter] is None else evaluate_rows(rows[letter], numbers.parameters) for letter in "DE")
    return Model(A, B, C, D, numbers.discrete, E)


def evaluate_rows(rows: Rows, by_name: Mapping[str, float]) -> Matrix:
    """Return rows of numbers and formulas as a matrix; raise ValueError if a formula has no finite value."""
    if not by_name:
        return np.array(rows, float)
    values = [
        [expression.value(expression.parse_formula(v), by_name) if isinstance(v, str) else v for v in row]
        for row in rows
    ]
    return np.array(values, float)


def actual(numbers: Numbers) -> Model:
    """Return the true plant: the share `drift` of `plant`, and 1 - `drift` of the model."""
    share, plant = numbers.drift, numbers.plant
    by_name = {name: (1 - share) * v + share * plant.get(name, v) for name, v in numbers.parameters.items()}
    model = nominal(numbers._replace(parameters=by_name)) if plant else nominal(numbers)
    nominal_model = model._replace(D=model.feedthrough)
    return model._replace(
        **{
            letter: (1 - share) * getattr(nominal_model, letter) + share * evaluate_rows(rows, by_name)
            for letter, rows in plant.items()
            if letter in MATRICES
        }
    )


def prepare(numbers: Numbers, dt: float, ticks: int) -> Params:
    """Return the map of one tick of `dt` seconds."""
    model = actual(numbers)
    Phi, Gamma = one_tick(model, dt)
    gain, bias = np.asarray(numbers.input_gain), np.asarray(numbers.input_bias)
    E, Gamma_f, f = np.zeros((len(Phi), 0)), np.zeros((len(Phi), 0)), np.zeros((1, 0))
    if model.E is not None:
        E, Gamma_f = model.E, one_tick(model._replace(B=model.E), dt)[1]
        f = inputs(numbers.unknown_input, dt * np.arange(ticks + 1, dtype=float), E.shape[1])
    return Params(
        Phi=Phi,
        Gamma=Gamma,
        A=model.A,
        B=model.B,
        C=model.C,
        D=model.feedthrough,
        gain=gain,
        bias=bias,
        E=E,
        Gamma_f=Gamma_f,
        f=f,
    )


def prepare_model(model: Model, gain: float, bias: float, dt: float, ticks: int) -> Params:
    """Return the map of one tick of a plant that differs from its model by input gain and bias only."""
    numbers = Numbers(A=model.A, B=model.B, C=model.C, D=model.D, discrete=model.discrete)
    return prepare(numbers._replace(input_gain=gain, input_bias=bias), dt, ticks)


def step(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Advance x by one tick under the held now.u."""
    x_next = params.Phi @ x + params.Gamma @ (params.gain * now.u + params.bias)
    return x_next + params.Gamma_f @ params.f[now.tick] if params.f.shape[1] else x_next


def output(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " q"]:
    """Return the measurement."""
    return params.C @ x + params.D @ (params.gain * now.u + params.bias)


def field(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return dx/dt under the held now.u; for a continuous plant only."""
    disturbance = params.E @ params.f[now.tick] if params.f.shape[1] else 0.0
    return jnp.asarray(params.A) @ x + params.B @ (params.gain * now.u + params.bias) + disturbance


def unknown(params: Params, now: Now, x: Float[Array, " n"]) -> Float[Array, " r"]:
    """Return the unknown input held over the tick."""
    return params.f[now.tick] if params.f.shape[1] else jnp.zeros(0)


PLANT = Plant(step, output, field, unknown)
