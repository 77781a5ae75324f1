"""A linear plant of one's own: its motion and its measurements, every observer on it, and what does not fit."""

import numpy as np
import pytest
from reference import irregular, linear
from scipy import signal

import pcbench
from pcbench.errors import UserError
from pcbench.study.lti import Lti

MOTOR = {
    "A": [[0.0, 1.0, 0.0], [0.0, -0.1, 2.0], [0.0, -0.5, -20.0]],
    "B": [[0.0], [0.0], [10.0]],
    "C": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    "states": ["angle [rad]", "speed [rad/s]", "current [A]"],
    "sampling_period": [0.04, 0.01],
    "delay": [0.06, 0.01],
    "noise_std": [0.01, 0.05],
    "duration": 0.6,
    "x0": [1.0, -2.0, 0.5],
}
RNG = np.random.default_rng(5)
DIRECT = {  # three states, two inputs, two outputs with feedthrough, no symmetry
    "A": (RNG.normal(size=(3, 3)) - 1.5 * np.eye(3)).tolist(),
    "B": RNG.normal(size=(3, 2)).tolist(),
    "C": RNG.normal(size=(2, 3)).tolist(),
    "D": RNG.normal(size=(2, 2)).tolist(),
    "input": "sine, square",
    "sampling_period": 0.05,
    "delay": 0.07,
    "noise_std": [0.1, 0.3],
    "duration": 0.6,
    "x0": [1.0, -2.0, 0.5],
}
SAMPLED = signal.cont2discrete(
    tuple(np.array(DIRECT[k]) for k in "ABCD"), 0.01
)  # the same plant, known at its ticks only
DISCRETE = DIRECT | {"A": SAMPLED[0].tolist(), "B": SAMPLED[1].tolist(), "dt": 0.01}
PLANTS = {"motor": MOTOR, "direct": DIRECT, "discrete": DISCRETE}
FEW = ["motor", pytest.param("direct", marks=pytest.mark.nightly), pytest.param("discrete", marks=pytest.mark.nightly)]
ONE_CLOCK = ["pccebo", "pccebo-riccati", "pco", "pi-pco", "kf", "kf-bias", "model-only"]
TWO_CLOCKS = ["kf", "kf-bias", "model-only"]
OPTIONS = {"pccebo-riccati": {"gain": "riccati"}, "kf-bias": {"bias_variance": 0.5}}


def study(plant, observers, **changes):
    options = {name: given for name, given in OPTIONS.items() if name in observers}
    return {"name": plant, "lti": PLANTS[plant] | changes, "observers": observers, "options": options}


def discretise(plant):
    """Phi, Gamma, C, D and the tick by scipy.signal."""
    own = PLANTS[plant]
    A, B, C = (np.array(own[k]) for k in "ABC")
    D = np.array(own.get("D", np.zeros((2, B.shape[1]))))
    if "dt" in own:
        return A, B, C, D, own["dt"]
    return *signal.cont2discrete((A, B, C, D), 1e-3)[:4], 1e-3


@pytest.fixture(scope="module", params=FEW)
def traced(request):
    """Plant, its tick matrices, and one run of every observer that takes its samples, started at the truth without noise."""
    plant = request.param
    observers = TWO_CLOCKS if plant == "motor" else ONE_CLOCK
    d = pcbench.simulate(study(plant, observers, noise_std=0.0, xhat0=PLANTS[plant]["x0"]), observers)
    return plant, observers, d


def columns(d, prefix, names):
    return d[[f"{prefix}{name}" for name in names]].to_numpy()


@pytest.mark.ci
def test_the_plant_moves_as_scipys(traced):
    plant, _, d = traced
    F, G, C, D, dt = discretise(plant)
    x, u = columns(d, "", names(plant)), columns(d, "u", range(1, G.shape[1] + 1))
    _, _, want = signal.dlsim((F, G, C, D, dt), u, x0=PLANTS[plant]["x0"])
    np.testing.assert_allclose(x, want, rtol=0, atol=1e-12 * np.abs(want).max())
    np.testing.assert_allclose(np.diff(d["t"]), dt, rtol=1e-9)


def names(plant):
    return [text.split(" ")[0] for text in PLANTS[plant].get("states", ["x1", "x2", "x3"])]


@pytest.mark.ci
def test_measurements_are_those_of_their_own_ticks_and_hold_the_input_of_that_tick(traced):
    plant, _, d = traced
    _, G, C, D, dt = discretise(plant)
    x, u, y = columns(d, "", names(plant)), columns(d, "u", range(1, G.shape[1] + 1)), columns(d, "y", (1, 2))
    own = PLANTS[plant]
    for j in range(2):
        te, late = (round(np.broadcast_to(own[key], 2)[j] / dt) for key in ("sampling_period", "delay"))
        for k in range(len(x)):
            if k < late:
                assert np.isnan(y[k, j])
            else:
                taken = (k - late) // te * te
                assert y[k, j] == pytest.approx(C[j] @ x[taken] + D[j] @ u[taken], rel=1e-12, abs=1e-12)


@pytest.mark.ci
def test_perfect_start_is_zero(traced):
    plant, observers, d = traced
    x = columns(d, "", names(plant))
    for observer in observers:
        e = x - columns(d, f"{observer}.", names(plant))
        assert np.abs(e).max() < 1e-12 * max(np.abs(x).max(), 1), observer


@pytest.fixture(scope="module", params=FEW)
def noisy(request):
    """Plant, one run of every observer, and what the reference needs: model, input, samples, D."""
    plant, own = request.param, PLANTS[request.param]
    observers = TWO_CLOCKS if plant == "motor" else ONE_CLOCK
    d = pcbench.simulate(study(plant, observers), observers)
    _, G, C, D, dt = discretise(plant)
    u, y = columns(d, "u", range(1, G.shape[1] + 1)), columns(d, "y", (1, 2))
    samples = []
    for j in range(2):
        te, late = (round(np.broadcast_to(own[key], 2)[j] / dt) for key in ("sampling_period", "delay"))
        for i, taken in enumerate(range(0, len(u) - late, te)):
            samples.append(linear.Sample(taken + late, taken, j, i, y[taken + late, j]))
    A, B = (np.array(PLANTS["direct" if plant == "discrete" else plant][k]) for k in "AB")
    return plant, d, linear.Model(A, B, C, dt), u, samples, D


def test_observers_equal_the_reference_with_two_clocks_or_feedthrough(noisy):
    plant, d, model, u, samples, D = noisy
    for observer in (TWO_CLOCKS if plant == "motor" else ONE_CLOCK)[:-1]:
        want = reference(plant, observer, model, u, samples, D)
        got = columns(d, f"{observer}.", names(plant))
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max(), err_msg=observer)


def reference(plant, observer, model, u, samples, D):
    own, start = PLANTS[plant], np.zeros(3)
    gains = pcbench.design(study(plant, [observer]), observer).gains
    if observer.startswith("kf"):
        P0, R = np.diag(np.square(own["x0"])), np.square(np.broadcast_to(own["noise_std"], 2))
        bias = 0.5 if observer == "kf-bias" else None
        return irregular.kf(model, u, samples, start, P0, R, None, bias, D)
    elif observer.startswith("pccebo"):
        return irregular.pccebo(model, u, samples, start, gains.L, D)
    Ki = gains.Ki if observer == "pi-pco" else None
    return irregular.pco(model, u, samples, start, gains.T, gains.Kp, Ki, D)


@pytest.mark.nightly
@pytest.mark.parametrize("noisy", ["direct"], indirect=True)
def test_kfbo_equals_the_reference_on_a_plant_of_ones_own_with_feedthrough(noisy):
    plant, _, model, u, samples, D = noisy
    own = study(plant, ["kfbo"])
    got = columns(pcbench.simulate(own, "kfbo"), "kfbo.", names(plant))
    known = [s._replace(value=s.value - D[s.channel] @ u[s.taken]) for s in samples]
    K = pcbench.design(own, "kfbo").certificate.numbers["K"]
    want = linear.kfbo(model, u, known, np.zeros(3), K, 50, 70)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max())


@pytest.mark.parametrize(("plant", "found"), [("discrete", "a discrete plant"), ("motor", "channels with delays")])
def test_kfbo_says_which_plants_it_does_not_take(plant, found):
    with pytest.raises(UserError, match=rf"got {found}.*expected a continuous plant and one delay"):
        pcbench.design(study(plant, ["kfbo"]), "kfbo")


BAD = {
    "A": ({"A": [[1.0, 2.0]]}, r"lti\.A: got 1 x 2, expected 1 x 1"),
    "ragged": ({"A": [[0.0, 1.0, 0.0], [0.0, 1.0], [0.0, 0.0, 1.0]]}, r"lti\.A: got rows of lengths \[3, 2, 3\]"),
    "B": ({"B": [[1.0], [2.0]]}, r"lti\.B: got 2 x 1, expected 3 x 1"),
    "C": ({"C": [[1.0, 0.0]]}, r"lti\.C: got 1 x 2, expected 1 x 3"),
    "D": ({"D": [[1.0]]}, r"lti\.D: got 1 x 1, expected 2 x 1"),
    "x0": ({"x0": [1.0]}, r"lti\.x0: got 1 numbers, expected 3"),
    "another tick": ({"dt": 0.01, "tick": 0.001}, "got a discrete plant of dt = 0.01 s and a tick of 0.001 s"),
    "not whole ticks": ({"sampling_period": 0.0405}, "whole number of ticks"),
    "names": ({"states": ["a", "b"]}, "got 2 names, expected 3"),
    "twice": ({"states": ["a", "b", "a"]}, "got 'a' twice"),
    "no name": ({"states": ["a", "b", "3 c"]}, "expected a name with a unit"),
    "steady_start": ({"steady_start": 9.0}, "expected less than the duration"),
    "input": ({"input": "cosine"}, "'cosine' is no input"),
    "inputs": ({"input": "sine, sine"}, "got 2 signals"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_does_not_fit_is_named_in_one_sentence(what):
    changes, sentence = BAD[what]
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study("motor", ["kf"], **changes), seeds=1)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("C", "observer", "sentence"),
    [
        ([[0.0, 0.0, 1.0]], "kf", "mode 0 is undetectable"),  # the angle integrates and is not seen
        ([[0.0, 1.0, 0.0]], "pco", "mode 0 is unobservable"),
        ([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], "pco", "expected independent outputs"),
    ],
)
def test_a_plant_that_cannot_be_observed_is_refused_with_its_mode(C, observer, sentence):
    changes = {"C": C, "sampling_period": 0.04, "delay": 0.04, "noise_std": 0.01}
    with pytest.raises(UserError, match=sentence):
        pcbench.design(study("motor", [observer], **changes), observer)


def test_two_clocks_are_refused_for_an_observer_that_takes_one():
    with pytest.raises(UserError, match="pccebo in lti got channels that differ"):
        pcbench.run(study("motor", ["pccebo"]), seeds=1)


@pytest.mark.ci
def test_the_table_in_a_file_runs(tmp_path):
    pytest.importorskip("tomli_w")
    import tomli_w

    path = tmp_path / "motor.toml"
    path.write_text(tomli_w.dumps({"lti": MOTOR, "seeds": 4}))
    d = pcbench.simulate(path, "kf")
    assert list(d.columns[:4]) == ["t", "angle", "speed", "current"]
    assert Lti(**MOTOR).observers == ["kf", "model-only"]
