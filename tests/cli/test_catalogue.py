"""What there is, as data: every name with what is said of it, numbers with their units."""

import shutil
from pathlib import Path

import pytest

from pcbench.cli import catalogue, facts
from pcbench.cli.catalogue import CATALOGUE, list_catalogue
from pcbench.controllers import CONTROLLERS
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES, parse
from pcbench.study.axes import AXES, COMMANDS, axes_of


def test_each_study_has_its_own_question():
    questions = [said["summary"] for said in list_catalogue("studies").values()]
    assert len(set(questions)) == len(STUDIES)
    assert all(question.endswith("?") for question in questions)


def test_everything_that_there_is_is_listed():
    for kind, known in (
        ("plants", PLANTS),
        ("observers", OBSERVERS),
        ("scenarios", SCENARIOS),
        ("studies", STUDIES),
        ("controllers", CONTROLLERS),
    ):
        assert list(list_catalogue(kind)) == list(known)
    for kind in CATALOGUE:
        assert all(said["summary"] for said in list_catalogue(kind).values())


def test_plants_have_their_signals_with_units_and_their_parameters_with_values():
    said = catalogue.plant(PLANTS["cart"])
    assert said["signals"] == [{"name": "position", "unit": "m"}, {"name": "velocity", "unit": "m/s"}]
    assert said["parameters"] == {"lam": 122, "b": 355, "drift_sign": 1, "input_bias": 0}
    assert said["unknown"] == []
    assert catalogue.plant(PLANTS["helicopter"])["unknown"][-1] == {"name": "yaw_viscosity", "unit": "N m s/rad"}


def test_scenarios_have_their_times_and_bands_in_their_units():
    said = catalogue.scenario(SCENARIOS["csth/10s"])
    assert [(s["name"], s["unit"], s["settled_within"], s["diverged_beyond"]) for s in said["signals"]] == [
        ("volume", "L", 0.025, 5e5),
        ("enthalpy", "J", 1000.0, 2e10),
        ("jacket_temperature", "degC", 0.25, 5e6),
    ]
    assert (said["tick"], said["duration"], said["steady_start"]) == (
        10.0,
        SCENARIOS["csth/10s"].duration,
        SCENARIOS["csth/10s"].scoring.steady_start,
    )
    assert list_catalogue("scenarios", "arm/sampled")["arm/sampled"]["delay"] == list(
        SCENARIOS["arm/sampled"].sampling.delay
    )
    assert catalogue.scenario(SCENARIOS["cart/white"])["axes"][-4:] == [
        "plant.lam",
        "plant.b",
        "plant.drift_sign",
        "plant.input_bias",
    ]


def test_scenario_lists_only_axes_that_it_accepts():
    axes = {name: catalogue.accepted_axes(SCENARIOS[name]) for name in ("cart/white", "csth/10s", "arm/sine")}
    assert {"actuator_delay", "loss", "parameter_drift"} <= {*axes["cart/white"]}
    assert "parameter_drift" not in axes["csth/10s"]
    assert axes["arm/sine"] == ["parameter_drift", "actuator_delay", "process_std"]
    loop = SCENARIOS["helicopter/constant"]
    assert "actuator_delay" in catalogue.accepted_axes(loop)
    for name in (name for name in axes_of(loop) if name not in catalogue.accepted_axes(loop)):
        study = {"name": "x", "scenarios": [loop.name], "observers": ["ekf"], "axes": {name: [REFUSED[name]]}}
        with pytest.raises(UserError, match=name if name in WITHOUT_EFFECT else "whose sampling began before t = 0"):
            parse.grid_of(study, {}, [])


WITHOUT_EFFECT = ("delay_self_transition", "delay_weights", "delay_gamma_shape", "mean_burst_length")
REFUSED = {
    **dict.fromkeys(("sampling_jitter", "delay_jitter", "timestamp_jitter", "delay_gamma_mean"), 0.05),
    **{"delay_values": [0.0, 0.05], "delay_sequence": [0.0, 0.05], "loss": 0.5, "delay_self_transition": 0.5},
    **{"delay_weights": [1.0, 2.0], "delay_gamma_shape": 2.0, "mean_burst_length": 5.0},
}


def test_list_of_axes_has_those_of_commands():
    assert [*list_catalogue("axes")] == [*AXES, *COMMANDS]


def test_observers_say_what_they_know_and_take():
    kfbo, kf = catalogue.observer(OBSERVERS["kfbo"]), catalogue.observer(OBSERVERS["kf"])
    assert (kfbo["knows_schedule"], kfbo["samples"]) == (False, "one constant delay")
    assert (kf["knows_schedule"], kf["samples"]) == (
        True,
        "any delay and order; each channel can have its own schedule",
    )
    assert catalogue.observer(OBSERVERS["model-only"])["options"] == {}


@pytest.mark.parametrize(
    ("schema", "said"),
    [
        ({"type": "number", "exclusiveMinimum": 0}, ("number", "> 0")),
        ({"type": "number", "minimum": 0, "maximum": 2}, ("number", ">= 0 and <= 2")),
        ({"type": "array", "items": {"type": "array"}}, ("matrix", None)),
        ({"anyOf": [{"type": "null"}, {"type": "integer"}]}, ("whole number", None)),
    ],
)
def test_an_option_says_its_type_and_range(schema, said):
    kind = facts.option_type(schema)
    assert (kind["type"], kind["range"]) == said


def test_what_is_a_users_own_is_said_by_its_code(tmp_path, monkeypatch):
    shutil.copy(Path(__file__).parents[1] / "support" / "own_loop.py", tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    assert list_catalogue("plants", "mine.py:pendulum")["mine.py:pendulum"]["parameters"] == {
        "length": 0.5,
        "friction": 0.4,
    }
    assert list_catalogue("controllers", "mine.py:law")["mine.py:law"]["options"]["kp"]["default"] == 2.0
    assert list_catalogue("scenarios", "mine.py:late")["mine.py:late"]["plant"] == "pendulum"
    with pytest.raises(UserError, match=r"got a plant, expected a pcbench\.Observer"):
        list_catalogue("observers", "mine.py:pendulum")
