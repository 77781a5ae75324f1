"""How many programs a built-in study compiles: what differs between its grid points is data wherever a run keeps its bits."""

import pytest

from pcbench.planning import build, padding
from pcbench.runtime import config
from pcbench.study import parse
from pcbench.study.builtin import STUDIES
from pcbench.study.grid import cells_of

PROGRAMS = {
    "quick": 1,
    "cart": 1,
    "unequal-delays": 1,
    "unknown-input": 2,
    "helicopter": 2,
    "equal-tuning": 1,
    "model-mismatch": 1,
    "delayed-measurements": 1,
    "measurement-errors": 5,
    "reactor": 3,  # each expensive observer has one of its own
    "equal-tuning-reactor": 2,
    "all": 30,
    "growth-model": 2,
    "falling-body": 1,
    "coordinated-turn": 1,
    "digester": 1,
    "camera-target": 2,
    "ncs-two-state": 1,
    "ncs-reactor": 2,  # try-once-discard is computed by the definition
    "intermittent": 1,
    "quadruple-tank": 1,
    "flexible-joint": 1,
    "outage": 1,
    "send-on-delta": 1,
    "processor": 3,  # an observer has one of its own
    "variable-sampling": 2,
}


def test_every_study_with_runs_has_its_count():
    assert {name for name, study in STUDIES.items() if study.evaluation != "exact"} == PROGRAMS.keys()


@pytest.mark.ci
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_study_compiles_no_more_programs(name):
    with config.float64():
        study = parse.grid_of(name, {}, []).study
        drafts = build.drafts(cells_of(study), runs=lambda cell: study.seeds, split_expensive=True)
        programs = {padding.key_of(p) for p in padding.fit(list(drafts))}
    assert len(programs) == PROGRAMS[name]
