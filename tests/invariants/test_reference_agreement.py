"""Every observer equals an independent NumPy reference, tick by tick, to 1e-10 of the signal's size.

The reference shares no code with pcbench: loops, lists and literal sums. Cases: d = te, d = 3 te, d = 0, d not a multiple of
te; noise on; drift on; several sampling periods; a plant with three states, two inputs and two outputs.
"""

import numpy as np
import pytest
from harness import CART, CHAINS, ELSEWHERE, ODD, Case, context_of, inputs, noise, starts, trace
from reference import cart as reference_cart
from reference import field_observers, held, irregular
from reference import linear as reference

from pcbench.observers import DELAYS, LATE, NONLINEAR, OBSERVERS
from pcbench.plants import PLANTS, cart

TIMES = [(100, 100), (60, 180), (150, 0), (40, 95)]
WHOLE_SAMPLES = [
    name for name, entry in OBSERVERS.items() if entry.takes == "constant delays"
]  # in test_chain, test_rivals
VARIANTS = [
    (name, {}) for name in OBSERVERS if name not in ("kfbo", *WHOLE_SAMPLES, *ELSEWHERE, *LATE, *NONLINEAR, *DELAYS)
]
VARIANTS += [
    ("kfbo", {"R": 0.004}),
    ("kfbo", {"R": 0.3, "lag_aware": True}),
    ("kfbo", {"R": 0.3, "sampled_innovation": True}),
]


def reference_estimates(case, observer, options, u, samples):
    """The reference's xhat[N+1, n], with the gains of the design under test (gains have tests of their own)."""
    model = reference.Model(case.model.A, case.model.B, case.model.C, case.h)
    known = context_of(case)
    design = OBSERVERS[observer].design(known, OBSERVERS[observer].options(**options))
    xhat0 = starts(case)[1]
    if observer == "model-only":
        return reference.model_only(model, u, xhat0)
    if observer in ("pccebo", "interval"):  # its bounds: tests/observers/test_interval.py
        return reference.pccebo(model, u, samples, xhat0, design.gains.L)
    if observer == "eso":
        return field_observers.eso(model, u, samples, xhat0, design.gains.L)
    if observer == "cdob":
        return field_observers.communication_disturbance(
            model, u, samples, xhat0, np.vstack([design.gains.L, design.gains.l])
        )
    if observer == "cascade-predictor":
        return field_observers.cascade(model, u, samples, xhat0, design.gains.K, design.gains.d)
    if observer == "super-twisting":
        Ad, Bd = reference.discretise(model.A, model.B, case.h)
        O, h = np.vstack([model.C, model.C @ model.A]), case.h
        return field_observers.super_twisting(
            lambda k, x: Ad @ x + Bd @ u[k], model.C, O, h, case.ticks, samples, xhat0, 1.0, case.te * h
        )
    if observer == "finite-time":
        g = design.gains
        return field_observers.finite_time(model, u, samples, xhat0, g.L, g.K, case.te, len(g.window))
    if observer in ("pco", "pi-pco"):
        g = design.gains
        return irregular.pco(model, u, samples, xhat0, g.T, g.Kp, g.Ki if observer == "pi-pco" else None)
    if observer == "lmi-sampled":
        return held.linear_run(model, u, samples, xhat0, design.gains.L)
    if observer == "kfbo":
        K = design.certificate.numbers["K"]
        flags = {key: options.get(key, False) for key in ("lag_aware", "sampled_innovation")}
        return reference.kfbo(model, u, samples, xhat0, K, case.te, case.d, **flags)
    if observer not in ("kf", "ekf", "kf-event"):  # Kalman's on a linear model, and where every sample is sent
        raise NotImplementedError(f"{observer} has no reference in tests/reference")
    W = case.input_intensity * case.model.B @ case.model.B.T
    return reference.kf(model, u, samples, xhat0, known.P0, design.gains.R, W)


def agree(case, observer, options, plant_step=None):
    u = inputs(case)
    model = reference.Model(case.model.A, case.model.B, case.model.C, case.h)
    q = len(case.model.C)
    x, samples = reference.simulate(model, u, starts(case)[0], [case.te] * q, [case.d] * q, noise(case), plant_step)
    got = trace(case, {observer: options})
    size = np.abs(x).max()
    np.testing.assert_allclose(got.x, x, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(
        got.estimates[observer], reference_estimates(case, observer, options, u, samples), rtol=0, atol=1e-10 * size
    )


@pytest.mark.parametrize(("te", "d"), TIMES)
@pytest.mark.parametrize(("observer", "options"), VARIANTS, ids=str)
def test_cart_with_noise_equals_the_reference(observer, options, te, d):
    agree(Case(CART, te, d, noise_std=0.7, x0=[5.0, 10.0], seed=3), observer, options)


@pytest.mark.parametrize(
    ("te", "d"), [(20, 70), *(pytest.param(*t, marks=pytest.mark.nightly) for t in ((30, 30), (26, 0)))]
)
@pytest.mark.parametrize(("observer", "options"), [each for each in VARIANTS if each[0] not in CHAINS], ids=str)
def test_three_states_two_inputs_two_outputs_equal_the_reference(observer, options, te, d):
    case = Case(ODD, te, d, ticks=400, h=0.01, noise_std=0.2, seed=5, xhat0=[0.5, -1.0, 2.0], input_intensity=0.05)
    agree(case, observer, options)


@pytest.mark.parametrize(("te", "d"), [pytest.param(100, 100, marks=pytest.mark.nightly), (50, 150)])
@pytest.mark.parametrize(("observer", "options"), VARIANTS, ids=str)
def test_drifting_cart_equals_the_reference(observer, options, te, d):
    params = cart.prepare(PLANTS["cart"].numbers._replace(drift=0.8), 1e-3, 900)
    case = Case(CART, te, d, noise_std=0.3, Phi=params.Phi, Gamma=params.Gamma, seed=1)
    agree(case, observer, options, reference_cart.drift_step(0.8, 1.0, cart.SUBSTEPS))
