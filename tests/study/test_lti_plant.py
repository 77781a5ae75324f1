"""A plant that differs from its model: matrices of its own, named numbers in formulas, what drifts, and what does not fit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import linear

import pcbench
from pcbench import expression, planning
from pcbench.errors import UserError
from pcbench.plants.lti import nominal
from pcbench.study import parse
from pcbench.study.grid import cells_of
from pcbench.study.lti import Lti

pytestmark = pytest.mark.usefixtures("in_a_hurry")

TICK, TICKS = 0.01, 60
PLANT = {  # a mass on a spring with an actuator: two named numbers in three matrices
    "A": [[0.0, 1.0, 0.0], ["-k", "-c/2", 1.0], [0.0, 0.0, -3.0]],
    "B": [[0.0, 0.5], [0.0, 0.0], ["3*(k - 1)^2", 0.0]],
    "C": [[1.0, 0.2, 0.0], [0.0, "1 + c", 0.4]],
    "parameters": {"k": 2.0, "c": 0.5},
    "input": "sine, square",
    "sampling_period": 0.04,
    "delay": 0.03,
    "noise_std": 0.1,
    "tick": TICK,
    "duration": TICK * TICKS,
    "x0": [1.0, -2.0, 0.5],
}


def matrices(k, c):
    A = np.array([[0.0, 1.0, 0.0], [-k, -c / 2, 1.0], [0.0, 0.0, -3.0]])
    return (
        A,
        np.array([[0.0, 0.5], [0.0, 0.0], [3 * (k - 1) ** 2, 0.0]]),
        np.array([[1.0, 0.2, 0.0], [0.0, 1 + c, 0.4]]),
    )


def study(lti=PLANT, **asked):
    return {"name": "own", "lti": lti, "observers": ["kf"]} | asked


def simulate(asked):
    """The states and inputs of a run."""
    d = pcbench.simulate(asked, ["kf"])
    return d[["x1", "x2", "x3"]].to_numpy(), d[["u1", "u2"]].to_numpy()


def loop(A, B, u):
    Phi, Gamma = linear.discretise(A, B, TICK)
    x = [np.array(PLANT["x0"])]
    for k in range(TICKS):
        x.append(Phi @ x[k] + Gamma @ u[k])
    return np.array(x)


DIFFERS = {  # what the study says besides, k and c of the plant, and what of its A and B is not by these
    "an axis": ({"axes": {"plant.k": [3.5]}}, {}, (3.5, 0.5), {}),
    "a named number": ({}, {"k": 3.5, "c": 0.1}, (3.5, 0.1), {}),
    "half of it": ({"axes": {"parameter_drift": [0.5]}}, {"k": 3.5, "c": 0.1}, (2.75, 0.3), {}),
    "none of it": ({"axes": {"parameter_drift": [0.0]}}, {"k": 3.5}, (2.0, 0.5), {}),
    "an axis over it": ({"axes": {"plant.k": [5.0]}}, {"k": 3.5, "c": 0.1}, (5.0, 0.1), {}),
    "matrices": ({}, {"A": (-np.eye(3)).tolist(), "B": [[1, 0], [0, 2], [3, 0]]}, (2.0, 0.5),
                 {"A": -np.eye(3), "B": np.array([[1.0, 0], [0, 2], [3, 0]])}),
    "a quarter of a matrix": ({"axes": {"parameter_drift": [0.25]}}, {"A": (-np.eye(3)).tolist()}, (2.0, 0.5),
                              {"A": 0.75 * matrices(2.0, 0.5)[0] - 0.25 * np.eye(3)}),
    "a matrix of an axis": ({"axes": {"plant.k": [4.0]}}, {"A": [[0, 1, 0], ["-2*k", 0, 0], [0, 0, -1]]}, (4.0, 0.5),
                            {"A": np.array([[0.0, 1, 0], [-8, 0, 0], [0, 0, -1]])}),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("what", DIFFERS)
def test_the_plant_moves_by_its_own_numbers_and_observers_keep_the_models(what):
    asked, plant, (k, c), own = DIFFERS[what]
    asked = study(PLANT | ({"plant": plant} if plant else {}), **asked)
    x, u = simulate(asked)
    A, B, _ = matrices(k, c)
    want = loop(own.get("A", A), own.get("B", B), u)
    np.testing.assert_allclose(x, want, rtol=0, atol=1e-12 * np.abs(want).max())
    (cell,) = cells_of(parse.parse(asked, "own"))
    model = planning.context_of(cell).model
    for got, known in zip(model[:3], matrices(2.0, 0.5), strict=True):
        np.testing.assert_allclose(got, known, rtol=1e-15)


def test_outputs_are_the_plants_too():
    C, D = [[2.0, 0.0, 1.0], [0.5, 1.0, 0.0]], [[0.7, -0.3], [0.0, 1.1]]
    (p,) = planning.plan(parse.parse(study(PLANT | {"plant": {"C": C, "D": D}}), "own"))
    np.testing.assert_array_equal(p.problem.params.C, C)
    np.testing.assert_array_equal(p.problem.params.D, D)
    np.testing.assert_allclose(p.problem.gains["kf"].C, matrices(2.0, 0.5)[2], rtol=1e-15)


def test_there_is_no_bound_where_the_plant_is_not_the_model_and_one_where_it_is():
    assert planning.plan(parse.parse(study(), "own"))[0].bound is not None
    for asked in (study(PLANT | {"plant": {"k": 3.0}}), study(axes={"plant.k": [3.0]})):
        assert planning.plan(parse.parse(asked, "own"))[0].bound is None


def test_a_range_of_a_named_number_is_proven_over():
    """The gain for a spring between 1.5 and 2.5 is certified over it; a name that is none is refused."""
    one = study(PLANT | {"noise_std": [0.1, 0.1]}, observers=["pccebo"])
    ranged = pcbench.design(one | {"options": {"pccebo": {"parameter_range": {"k": [1.5, 2.5]}}}}, "pccebo")
    assert ranged.certificate.margin > 0
    with pytest.raises(UserError, match="'m' is no parameter of plant lti"):
        pcbench.design(one | {"options": {"pccebo": {"parameter_range": {"m": [1.5, 2.5]}}}}, "pccebo")


@pytest.mark.ci
def test_a_study_with_named_numbers_is_written_and_run_again(tmp_path):
    asked = study(PLANT | {"plant": {"k": 2.5, "A": PLANT["A"]}}, seeds=4)
    pcbench.run(asked, out=tmp_path / "out")
    again = pcbench.run(str(tmp_path / "out" / "study.toml"), out=tmp_path / "out")
    assert again.cost.runs == 0
    assert set(pcbench.open_result(tmp_path / "out").stats.observer) == {"kf"}


BAD = {
    "no parameters": (
        {"parameters": None},
        r"lti\.A\[1\]\[0\]: got '-k', expected a number, or a table \[lti.parameters\]",
    ),
    "no such": (
        {"parameters": {"k": 1.0, "cc": 2.0}},
        r"lti\.A\[1\]\[1\]: 'c' is no parameter of lti; did you mean 'cc'",
    ),
    "no formula": ({"C": [["k +", 0.0, 0.0]]}, r"lti\.C\[0\]\[0\]: got 'k \+', expected .*a formula that goes on"),
    "a call": ({"C": [["exp(k)", 0.0, 0.0]]}, r"lti\.C\[0\]\[0\]: got 'exp\(k\)', expected .*ends before '\('"),
    "a sign": ({"C": [["k;c", 0.0, 0.0]]}, r"expected .*a formula of numbers, names, .*not ';'"),
    "too long": ({"C": [["(" * 101, 0.0, 0.0]]}, "a formula of at most 100 characters"),
    "no value": (
        {"C": [["1/(k - 2)", 0.0, 0.0]]},
        r"lti\.C\[0\]\[0\]: got '1/\(k - 2\)', expected a finite number at k = 2",
    ),
    "unused": ({"parameters": {"k": 1.0, "c": 2.0, "m": 3.0}}, "got m, which enters no matrix, expected one that does"),
    "a taken name": (
        {"parameters": {"k": 1.0, "c": 2.0, "drift": 3.0}},
        "got a parameter called 'drift'",
    ),
    "no name": ({"parameters": {"k": 1.0, "c": 2.0, "a b": 3.0}}, "got a parameter called 'a b'"),
    "a text": ({"parameters": {"k": "2", "c": 1.0}}, r"lti\.parameters\.k: got '2', expected a valid number"),
    "nothing": ({"plant": {}}, r"lti\.plant: got an empty table"),
    "no key": ({"plant": {"kk": 1.0}}, r"lti\.plant: 'kk' is no matrix or parameter of the plant; did you mean 'k'"),
    "E without E": ({"plant": {"E": [[1.0]] * 3}}, r"lti\.plant: 'E' is no matrix or parameter of the plant"),
    "a shape": (
        {"plant": {"A": [[1.0, 2.0]]}},
        r"lti\.plant\.A: got 1 rows of 2 numbers, expected 3 x 3, as the model's",
    ),
    "a flat B": ({"plant": {"B": [1.0, 2.0, 3.0]}}, r"lti\.plant\.B: got .*, expected a list of rows"),
    "a text there": ({"plant": {"k": "2"}}, r"lti\.plant\.k: got '2', expected a valid number"),
    "growth": ({"plant": {"k": -1e12}}, r"the plant's matrix lti\.A: got a plant that grows by"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_does_not_fit_is_named_in_one_sentence_and_nothing_is_written(what, tmp_path):
    changes, sentence = BAD[what]
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study({k: v for k, v in (PLANT | changes).items() if v is not None}), seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


AXES = {
    "drift of a true model": ({"parameter_drift": [0.0, 1.0]}, r"parameter_drift: got \[0\.0, 1\.0\] for lti, which"),
    "no such": ({"plant.m": [1.0]}, r"'plant\.m' is no axis of lti; .*plant\.k"),
    "no value": ({"plant.c": [-0.1, 0.0]}, r"got a plant with k = 2, c = 0, where a formula of a matrix has no finite value"),
}  # fmt: skip


@pytest.mark.parametrize("what", AXES)
def test_an_axis_without_an_effect_or_a_value_is_refused_in_one_sentence(what, tmp_path):
    axes, sentence = AXES[what]
    lti = PLANT | {"C": [[1.0, 0.2, 0.0], [0.0, "1/c", 0.4]]}
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study(lti), axes=axes, seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_drift_is_refused_on_the_tank_where_nothing_drifts_and_0_is_what_it_is():
    with pytest.raises(
        UserError, match=r"axes\.parameter_drift: got \[0\.5\] for csth/10s, which has no parameter drift"
    ):
        parse.parse({"name": "tank", "scenarios": ["csth/10s"], "axes": {"parameter_drift": [0.5]}}, "tank")
    parse.parse({"name": "tank", "scenarios": ["csth/10s"], "axes": {"parameter_drift": [0.0]}}, "tank")


def test_named_numbers_are_put_in_where_matrices_are_given_back():
    own = pytest.importorskip("scipy.signal") and pcbench.to_scipy(parse.parse(study(), "own"))
    for got, want in zip((own.A, own.B, own.C), matrices(2.0, 0.5), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-15)
    assert nominal(Lti.model_validate(PLANT).numbers("lti")).A.shape == (3, 3)


LEAVES = st.sampled_from(["k", "c2", "2", "0.5", "1e-1", ".25"])
FORMULAS = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from([" + ", "-", " * ", "/"]), inner).map("".join),
        inner.map("({})".format),
        inner.map("-({})".format),
        st.tuples(inner, st.sampled_from(["2", "-1", "(1+1)"])).map(lambda p: f"({p[0]})^{p[1]}"),
    ),
    max_leaves=6,
)


@given(text=FORMULAS)
def test_a_formula_comes_to_what_python_makes_of_it(text):
    numbers = {"k": 1.75, "c2": -0.6}
    if len(text) > expression.LONGEST:
        return
    try:
        want = eval(text.replace("^", "**"), {}, numbers)
    except ArithmeticError:
        want = np.inf
    if not np.isfinite(want):
        with pytest.raises(ValueError, match="finite"):
            expression.value(expression.parse_formula(text), numbers)
        return
    assert expression.value(expression.parse_formula(text), numbers) == pytest.approx(want, rel=1e-12)
    assert expression.names(expression.parse_formula(text)) == {name for name in numbers if name in text}
