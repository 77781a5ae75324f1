"""What a closing table says besides its numbers, in a sentence each."""

import pandas as pd
from rich.console import Console

from pcbench.plants import settles_alone
from pcbench.scenarios import Scenario


def carried(stats: pd.DataFrame, console: Console) -> None:
    """Say which predictions to the present carry the unknown input that was found."""
    said = stats[["observer", "predicts_unknown_input"]].dropna().drop_duplicates()
    for carries, text in ((True, "carries"), (False, "does not carry")):
        names = ", ".join(dict.fromkeys(said.observer[said.predicts_unknown_input == carries]))
        if names:
            console.print(f"The prediction to now {text} the unknown input found: {names}.", highlight=False)


def settles(scenario: Scenario, axes: list[str], console: Console) -> None:
    """Say where no observer is needed: on a plant that is known exactly and forgets its start."""
    pushed = any(axis in ("parameter_drift", "process_std") or axis.startswith("plant.") for axis in axes)
    if not pushed and settles_alone(scenario):
        console.print(
            f"{scenario.name}: the plant decays by itself, is what its model says, and has no process noise. There the model "
            "alone wins in the end, and no answer about periods or delays follows; say what pushes it (process_std).",
            highlight=False,
        )
