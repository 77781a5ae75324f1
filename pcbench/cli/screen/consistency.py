"""Which observers know how wrong they are, in a line each."""

import pandas as pd
from rich.console import Console

from pcbench.statistics.consistency import Band, verdict


def said(stats: pd.DataFrame, console: Console) -> None:
    """Say for every observer that has a covariance, and every cell, whether its errors are what it believes them to be."""
    rows = stats.set_index(["cell", "observer", "metric"])[["mean", "ci_low", "ci_high"]]
    for cell, observer in dict.fromkeys(
        stats[stats.metric == "nees"][["cell", "observer"]].itertuples(index=False, name=None)
    ):
        found, band = (rows.loc[[(cell, observer, metric)]].iloc[0] for metric in ("nees", "nees_band"))
        word = verdict(found["mean"], Band(band.ci_low, band.ci_high))
        where = f"cell {cell}: " if stats.cell.nunique() > 1 else ""
        console.print(
            f"{where}{observer} is {word}: its squared error is {found['mean']:.3g} times what it believes, of a true belief "
            f"{band.ci_low:.3g} to {band.ci_high:.3g}.",
            highlight=False,
            markup=False,
        )
