"""What is it that a name stands for: an observer, a plant, a controller, a scenario; or a study in a file?"""

from pathlib import Path

from pcbench.errors import UserError, short, unknown
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES
from pcbench.study.plugins import user_code
from pcbench.study.plugins.registry import KINDS, called

WHERE = "check"
STUDY = "study"


def kind_of(target: str) -> str:
    """Return the kind of what MODULE:NAME names, or `study`; raise UserError where it is none, or not there.

    A study is a TOML file, a built-in one, or a published scenario.
    """
    if target.endswith(".toml") or target in STUDIES or target in SCENARIOS:
        return STUDY
    if not user_code.is_reference(target):
        raise UserError(
            f"{WHERE}: got '{short(target)}', expected MODULE:NAME such as mine.py:nudge, or a study file such as motor.toml; "
            "name the module, or its file, and what it is called in it."
        )
    code = user_code.code_of(target, WHERE)
    here = Path(user_code.split(target, WHERE)[0]).resolve().parent if code.files else None
    types = tuple(each for kind in KINDS.values() for each in kind.types)
    found, there = user_code.found_in(user_code.module_of(code, WHERE, here), code.name, types)
    if found is None:
        raise unknown(f"{WHERE} {code.module}", f"{', '.join([*KINDS][:-1])} or {[*KINDS][-1]} there", code.name, there)
    for name, kind in KINDS.items():
        if isinstance(found, kind.types):
            return name
    expected = " or ".join(
        f"{'an' if name[0] in 'aeiou' else 'a'} {name} ({kind.expected})" for name, kind in KINDS.items()
    )
    raise UserError(f"{WHERE}: got {called(found)} called {code.name}, expected {expected}; name one of those.")
