"""A scenario's fields are changed and read by name, whatever record has them, and digests do not see the records."""

from collections import Counter

import pytest

from pcbench import controllers, planning, plants
from pcbench.controllers import CONTROLLERS
from pcbench.controllers.pd import Options
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.scenarios.scenario import CODE, RECORDS
from pcbench.study.grid import cell_of
from pcbench.study.plugins.user_code import Code, UserPlugin

ARM = SCENARIOS["arm/sampled"]


def test_no_two_records_have_a_field_of_the_same_name():
    names = [*Scenario._fields, *(field for fields in RECORDS.values() for field in fields)]
    assert max(Counter(names).values()) == 1
    assert set(ARM.flat()) == set(names) - set(RECORDS) - set(CODE)


def test_fields_are_changed_in_the_record_that_has_them_and_nowhere_else():
    changed = ARM.with_fields(delay=(0.1, 0.1), noise_std=(1.0, 1.0), parameter_drift=0.5, duration=3.0)
    assert (changed.sampling.delay, changed.sampling.noise_std) == ((0.1, 0.1), (1.0, 1.0))
    assert (changed.truth.parameter_drift, changed.duration) == (0.5, 3.0)
    different = {name for name, value in changed.flat().items() if value != ARM.value(name)}
    assert different == {"delay", "noise_std", "parameter_drift", "duration"}


@pytest.mark.parametrize("name", ["delays", "sampling", "truth"])
def test_a_name_that_is_no_field_is_refused(name):
    with pytest.raises(TypeError, match=f"no field '{name}'"):
        ARM.with_fields(**{name: 1.0})


def test_a_scenario_may_carry_its_plant_and_its_controller_of_which_it_says_the_code():
    """The functions of a user's own: looked up before names are, and in no file; the digest of their code is."""
    plain = SCENARIOS["helicopter/constant"]
    plant, law = PLANTS["helicopter"]._replace(heavy=False), CONTROLLERS["pd"]._replace(options=Options)
    code = Code("mine.py", "mine", (), "abc")
    own = plain.with_fields(
        user_code={"plant": UserPlugin(plant, code), "controller": UserPlugin(law, code)},
        plant="mine",
        controller="mine",
    )
    assert (plants.entry_of(own), controllers.entry_of(own)) == (plant, law)
    assert (plants.entry_of(plain), controllers.entry_of(plain)) == (PLANTS["helicopter"], CONTROLLERS["pd"])
    code = {"plant": "abc", "controller": "abc"}
    assert own.with_fields(plant="helicopter", controller="pd").flat() == plain.flat() | {"code": code}
    assert planning.build.width(cell_of(own)) != planning.build.width(cell_of(plain))
