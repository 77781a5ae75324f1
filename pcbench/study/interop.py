"""Convert linear plants from and to scipy.signal and python-control.

    study = pcbench.lti(scipy.signal.StateSpace(A, B, C, D), sampling_period=0.1, delay=0.2, noise_std=0.01)
    pcbench.run(study, observers=["kf", "pccebo"])

Both libraries are imported only to return a system. Any object with A, B, C, D and dt is a state-space system. Any object with
`to_ss` (scipy's transfer functions) is converted to one.
"""

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pcbench.errors import UserError, first_sentence, unknown
from pcbench.plants.lti import nominal
from pcbench.study import Study
from pcbench.study.lti import Lti
from pcbench.study.parse import parse
from pcbench.study.plugins.user_plants import plain
from pcbench.toml_text import TomlTable

if TYPE_CHECKING:
    import control
    from scipy import signal


def lti(system: object, *, name: str = "lti", **experiment: object) -> Study:
    """Make a study of a linear plant, for `run`, `simulate` or `design`.

    A continuous system is simulated exactly under an input held over `tick` (default 0.001 s), a discrete one at its own
    time base.

    Args:
        system: a scipy.signal.StateSpace or dlti, a control.StateSpace, or any representation with `to_ss`; n states, m
            inputs, q outputs.
        name: name of the study.
        **experiment: keys of a study's `[lti]` table. Required: sampling_period [s], delay [s] and noise_std [unit of the
            output], one number or one per output. Optional: input, x0, duration, observers and others.

    Returns:
        The study. Its states have the labels of a control.StateSpace if these are plain names.

    Raises:
        UserError: the system has no known time base or no state space, or a key does not fit.
    """
    matrices = _state_space(system)
    for key in experiment:
        if key not in Lti.model_fields or key in ("A", "B", "C", "D", "dt"):
            valid = [field for field in Lti.model_fields if field not in ("A", "B", "C", "D", "dt")]
            raise unknown("pcbench.lti", "key of an experiment", key, valid)
    labels = [str(label) for label in getattr(system, "state_labels", None) or []]
    states = {"states": labels} if labels and all(re.fullmatch(r"[A-Za-z]\w*", label) for label in labels) else {}
    table = {key: plain(value) for key, value in experiment.items() if value is not None}
    return parse({"name": name, "lti": matrices | states | table}, "pcbench.lti")


def to_scipy(study: Study) -> "signal.StateSpace | signal.dlti":
    """Convert a study's `[lti]` plant for SciPy.

    Args:
        study: a study with an `[lti]` table, or one made by `lti`.

    Returns:
        scipy.signal's StateSpace of a continuous plant, or a dlti.

    Raises:
        UserError: the study has no such plant.
    """
    from scipy import signal

    matrices, dt, _ = _plant(study)
    return signal.StateSpace(*matrices, **({} if dt is None else {"dt": dt}))


def to_control(study: Study) -> "control.StateSpace":
    """Convert a study's `[lti]` plant for python-control.

    Args:
        study: a study with an `[lti]` table, or one made by `lti`.

    Returns:
        A control.StateSpace with the names of the states.

    Raises:
        UserError: the study has no such plant, or python-control is not installed (pip install "pcbench[control]").
    """
    try:
        import control
    except ImportError:
        raise UserError('to_control: python-control is not installed; run pip install "pcbench[control]".') from None
    matrices, dt, states = _plant(study)
    labels = [text.split("[")[0].strip() for text in states]
    return control.StateSpace(*matrices, 0 if dt is None else dt, **({"states": labels} if labels else {}))


def _state_space(system: object) -> TomlTable:
    """Return the [lti] table's matrices of a system."""
    try:
        ss = system if all(hasattr(system, key) for key in "ABCD") else getattr(system, "to_ss", lambda: None)()
    except (NotImplementedError, ImportError, ValueError, ArithmeticError) as error:  # errors of the library
        raise UserError(
            f"pcbench.lti: got {type(system).__name__}, which its library cannot convert "
            f"('{first_sentence(error)}'), expected a state-space system; give its A, B, C and D."
        ) from error
    if ss is None:
        raise UserError(
            f"pcbench.lti: got {type(system).__name__}, expected a state-space system of scipy.signal or python-control; "
            "convert it with control.ss(system)."
        )
    dt: float | None = getattr(ss, "dt", None)
    if dt is True or (dt is None and hasattr(ss, "state_labels")):
        raise UserError(
            f"pcbench.lti: got a system with dt = {dt}, whose time base is unknown, expected seconds; give it dt in seconds"
            + (", or 0 for a continuous one." if dt is None else ".")
        )
    matrices = {key: plain(np.asarray(getattr(ss, key), float)) for key in "ABCD"}
    return matrices | ({"dt": float(dt)} if dt else {})


def _plant(study: Study) -> tuple[list[NDArray[np.float64]], float | None, list[str]]:
    """Return A, B, C and D of a study's plant, its time base [s] (None: continuous), and the labels of its states."""
    if study.lti is None:
        raise UserError(
            f"{study.name}: has no plant of its own, expected a study with [lti] or one made by pcbench.lti."
        )
    model = nominal(study.lti.numbers("lti"))
    return [model.A, model.B, model.C, model.feedthrough], study.lti.dt, study.lti.states or []
