"""What there is, listed with its numbers and units."""

from pcbench import catalogue
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES


def test_everything_that_there_is_is_listed():
    for kind, known in (("plants", PLANTS), ("observers", OBSERVERS), ("scenarios", SCENARIOS), ("studies", STUDIES)):
        heads, rows = catalogue.CATALOGUE[kind]()
        assert list(rows) == list(known)
        assert {len(row) for row in rows.values()} == {len(heads) - 1}


def test_plants_have_their_signals_with_units_and_their_parameters_with_values():
    _, rows = catalogue.plants()
    assert rows["cart"][1:] == ("position [m], velocity [m/s]", "lam 122, b 355, input_bias 0")
    assert rows["helicopter"][1].endswith("yaw_viscosity [N m s/rad]")
    assert "Bth 0.8, Bps 0.318" in rows["helicopter"][2]


def test_scenarios_have_their_times_and_bands_in_their_units():
    _, rows = catalogue.scenarios()
    assert rows["cart/white"][1] == (
        "10 s, tail from 3 s; settled within 0.25 m, 0.5 m/s; diverged beyond 1e+06 m, 1e+06 m/s"
    )
    assert "0.025 L, 1000 J, 0.25 degC; diverged beyond 500000 L, 2e+10 J, 5e+06 degC" in rows["csth/10s"][1]


def test_observers_say_what_they_know_and_take():
    _, rows = catalogue.observers()
    assert rows["kfbo"][1:3] == ("no", "of one constant age")
    assert rows["dkf"][1:3] == ("yes", "of any age, in any order, from clocks of their own")
    assert rows["open-loop"][3] == "none"
    assert "bias-variance (prior variance of a constant input bias" in rows["dkf"][3]
