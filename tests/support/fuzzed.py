"""Studies as nobody would write them, for hypothesis: any TOML at all, and valid studies changed in one to three places."""

import datetime
from copy import deepcopy

from hypothesis import strategies as st

from pcbench.observers import OBSERVERS
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES, Choices, Study
from pcbench.study.axes import AXES

ARM = {
    "A": [[0.0, 1, 0, 0], [-3.75, -0.0015, 3.75, 0], [0, 0, 0, 1], [3.75, 0, -3.75, -0.00125]],
    "B": [[0.0], [0], [0], [0.25]],
    "C": [[0.0, 1, 0, 0], [0, 0, 1, 0]],
    "E": [[0.0], [1], [0], [0]],
    "sampling_period": 0.02,
    "delay": [0.02, 0.02],
    "noise_std": 1e-3,
    "duration": 0.2,
    "unknown_std": [1.0],
    "observers": ["smo", "pio", "kf", "model-only"],
}
SPRING = {
    "A": [[0.0, 1.0], [-4.0, -0.5]],
    "B": [[0.0], [1.0]],
    "C": [[1.0, 0.0]],
    "D": [[0.0]],
    "states": ["angle [rad]", "rate [rad/s]"],
    "tick": 0.01,
    "sampling_period": 0.1,
    "delay": 0.1,
    "noise_std": 0.1,
    "x0": [1.0, 0.0],
    "xhat0": [0.0, 0.0],
    "prior_std": [1.0, 1.0],
    "settle_band": [0.1, 0.1],
    "divergence_threshold": 1e6,
    "duration": 2.0,
    "steady_start": 1.0,
    "input": "sine",
    "observers": ["pccebo", "kfbo", "kf", "model-only"],
    "sampling_pattern": "periodic",
    "sampling_jitter": 0.0,
    "delay_jitter": 0.0,
    "loss": 0.0,
}
STEPS = {  # a discrete plant, three states and two outputs
    "A": [[0.9, 0.1, 0.0], [0.0, 0.8, 0.1], [0.0, 0.0, 0.7]],
    "B": [[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]],
    "C": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    "dt": 0.5,
    "sampling_period": [1.0, 1.0],
    "delay": [1.0, 2.0],
    "noise_std": [0.1, 0.0],
    "duration": 50.0,
    "input": "sine, square",
    "observers": ["chain", "chain-slow", "equal-delay", "no-delay", "kf", "model-only"],
}
OPTIONS = {
    "pccebo": {"gain": "riccati", "q": 0.01},
    "kfbo": {"R": 0.3, "Q": 0.01, "lag-aware": True, "sampled-innovation": False},
    "kf": {"R": 0.1, "q": 0.0, "bias-variance": 1.0, "input-walk": 1.0},
    "chain-slow": {"gain": "poles", "pole-per-tick": 0.8, "output": "deadbeat", "shared": True},
    "chain": {"gain": "riccati", "q": 0.1},
    "equal-delay": {"variant": "theorem1", "delay": 2, "pole": 0.1},
    "no-delay": {"variant": "plain", "pole": 0.5},
    "smo": {"alpha": 1.0, "rho": 1.0, "eps": 0.005},
    "pio": {"beta": 0.5, "xi": 2.0, "reconstruct": True},
    "scenario": {"random-initial-state": False, "initial-spread": 0.1, "precision": "float64"},
}


def own(lti, **more):
    """A study of a plant of one's own, small enough to be planned, with options for its observers."""
    names = [*lti["observers"], "scenario"]
    return {"name": "own", "lti": lti, "seeds": 2, "options": {o: OPTIONS[o] for o in names if o in OPTIONS}} | more


OWN = [
    own(SPRING),
    own(SPRING, axes={"sampling_period": [0.1, 0.2], "noise_std": [0.0, 0.1], "plant": {"input_gain": [0.9, 1.1]}}),
    own(
        SPRING | {"observers": ["pco", "kf"]},
        axes={"sampling_pattern": ["sine", [0.1, 0.2]], "sampling_jitter": [0.0, 0.02]},
    ),
    own(SPRING | {"observers": ["kf"], "loss": 0.1, "delay": "interval"}, axes={"delay_jitter": [0.0, 0.05]}),
    own(SPRING | {"observers": ["kf", "ekf"]}, axes={"assumed_delay_error": [-0.1, 0.0, 0.1]}, observers=["kf"]),
    own(STEPS),
    own(STEPS, axes={"delay": [[1.0, 2.0], [0.0, 3.0]], "noise_std": [0.1, [0.1, 0.2]]}),
    own(ARM),
    {
        "name": "tank",
        "scenarios": ["csth/1s"],
        "axes": {"delay": [[2.0, 5.0, 7.0]]},
        "options": {"chain": {"pole": 0.1}},
    },
]
PUBLISHED = [{"name": "one", "scenarios": [name], "seeds": 2, "root_seed": 1} for name in SCENARIOS]
BUILT_IN = [study.model_dump(exclude_none=True) for study in STUDIES.values()]

NUMBERS = [0, -1, 1, 2, 0.0, -0.0, 0.1, 0.5, 1e-300, -1e-300, 1e-12, 1e-9, 1e9, 1e12, 1e16, 1e308, -1e308, 10**30, -(10**30),
           2**31, 2**63, 10**400, float("nan"), float("inf"), float("-inf")]  # fmt: skip
TEXTS = ["", " ", "0.1", "nan", "interval", "sine", "uniform", "a, b", ",", "\n", "\u202e\x00", "x" * 300]
LISTS = [[], [[]], [[[]]], [0.1, 0.2], [1.0, 2.0, 3.0], [[0.1]], [[1.0, 2.0], [3.0]], [""], [True], {}, {"a": 1}, [{}]]
TIMES = [datetime.date(1979, 5, 27), datetime.time(7, 32), datetime.datetime(1979, 5, 27, tzinfo=datetime.UTC)]
NAMES = [*Study.model_fields, *AXES, *OBSERVERS, *SCENARIOS, *Choices.model_fields, "plant", "plant.lam", "R", "Q", "Kp",
         "A", "B", "E", "dt", "tick", "duration", "steady_start", "x0", "lag_aware", "kf-other", "kf-\n", "", "a b",
         "\n"]  # fmt: skip
keys = st.sampled_from(NAMES) | st.text(max_size=8)
leaves = (
    st.sampled_from(NUMBERS)
    | st.sampled_from(TEXTS + LISTS + TIMES)
    | st.sampled_from(NAMES)
    | st.floats()
    | st.text(max_size=8)
)
leaves |= st.integers(-(10**30), 10**30) | st.datetimes() | st.dates() | st.times() | st.booleans()
values = st.recursive(leaves, lambda v: st.lists(v, max_size=4) | st.dictionaries(keys, v, max_size=4), max_leaves=12)
documents = st.dictionaries(keys, values, max_size=8)


def places(value, path=()):
    """Every place in a document: the path to each table, list and value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, each in inner for place in places(each, (*path, key)))]


def at(value, path):
    """What stands at a place."""
    for key in path:
        value = value.get(key) if isinstance(value, dict) else value[key]
    return value


LIKELY = [0, 0.0, 1, -1, 0.01, 0.1, 0.2, 0.5, 1.0, 2.0, 1e-12, 1e-6, 1e3, 1e6, 1e12, -1e12]
HOW = ["likely"] * 6 + ["number"] * 2 + ["value", "none", "text", "list", "more"]


@st.composite
def mutants(draw, studies):
    """A valid study with one to three places changed: another value, none, another type, or one more key."""
    study = deepcopy(draw(st.sampled_from(studies)))
    for _ in range(draw(st.integers(1, 3))):
        how, every = draw(st.sampled_from(HOW)), places(study)[1:] or [("name",)]
        numbers = [place for place in every if isinstance(at(study, place), int | float)]
        *path, last = draw(st.sampled_from(numbers if how == "likely" and numbers else every))
        table = at(study, path)
        here = table.get(last) if isinstance(table, dict) else table[last]
        match how:
            case "none" if last in table or isinstance(table, list):
                del table[last]
            case "more" if isinstance(table, dict):
                table[draw(keys)] = deepcopy(draw(values))
            case "more":
                table.insert(last, deepcopy(draw(values)))
            case "text":
                table[last] = str(here)
            case "list":
                table[last] = [deepcopy(here) for _ in range(draw(st.integers(1, 3)))]
            case "likely" if isinstance(here, int | float):
                table[last] = draw(st.sampled_from(LIKELY))
            case "number":
                table[last] = draw(st.sampled_from(NUMBERS))
            case _:
                table[last] = deepcopy(draw(values))
    return study


POINT = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "tick": 0.01, "sampling_period": 0.1, "delay": 0.1, "noise_std": 0.1,
         "duration": 0.3, "observers": ["kf", "model-only"]}  # fmt: skip
SIZES = st.sampled_from([0.0, 1e-100, 1e-30, 1e-12, 1e-6, 0.5, 1.0, 10.0, 1e3, 1e6, 1e12])
SIGNED = st.builds(lambda size, sign: sign * size, SIZES, st.sampled_from([-1.0, 1.0]))
extreme = st.fixed_dictionaries(  # what one state may have in its table [lti]: all of one shape, so all run one program
    {},
    optional=dict.fromkeys("ABCD", SIGNED.map(lambda v: [[v]]))
    | dict.fromkeys(["x0", "xhat0"], SIGNED.map(lambda v: [v]))
    | dict.fromkeys(["prior_std", "settle_band"], SIZES.map(lambda v: [v]))
    | dict.fromkeys(["noise_std", "divergence_threshold"], SIZES)
    | {"delay": st.sampled_from([0.1, 0.12, 0.15]), "input": st.sampled_from(["sine", "zero", "step"])},
).map(lambda changes: {"name": "point", "seeds": 2, "lti": POINT | changes})
