"""Start against tuned, on the training runs and on runs that no gradient has seen: the tables' own numbers.

What a study's `tune.only` names of each observer, and whether the labels of its versions are free.
"""

from pcbench.dataset import run_study
from pcbench.dataset.seed_ranges import Seeds
from pcbench.errors import UserError, unknown
from pcbench.gains import parameters
from pcbench.gains.history import Judgement
from pcbench.gains.objective import Objective
from pcbench.observers import base_of
from pcbench.scenarios import Scenario
from pcbench.statistics import POOLED
from pcbench.study import Study, merge_options, parse, scenarios_of
from pcbench.study.labels import entry_in
from pcbench.toml_text import TomlTable

WORSE = 2.0  # standard errors that tuned may be worse than its start


def judge(study: Study, observer: str, found: TomlTable, aim: Objective, seeds: dict[str, Seeds]) -> list[Judgement]:
    """Run start and tuned on the same draws, for each range of seeds."""
    base = base_of(observer) or observer
    mine = merge_options(study, scenarios_of(study)[study.scenarios[0]], observer)
    labels = f"{base}-start", f"{base}-tuned"
    options = {k: v for k, v in study.options.items() if k != observer or k == base}
    options |= {labels[0]: mine, labels[1]: mine | found}
    metric, out = POOLED.get(aim.metric, aim.metric), []
    for what, each in seeds.items():
        changes = {"observers": list(labels), "options": options, "first_seed": each.first, "seeds": each.many}
        result = run_study.execute(parse.grid_of(study, changes, []))
        stats = result.stats[(result.stats.signal == aim.name) & (result.stats.metric == metric)].set_index("observer")
        (pair,) = result.pairs[(result.pairs.signal == aim.name) & (result.pairs.metric == metric)].to_dict("records")
        sign = 1.0 if pair["observer_a"] == labels[1] else -1.0
        (a, a_se, bad), (b, b_se, worse) = stats.loc[list(labels), ["mean", "se", "diverged"]].to_numpy().tolist()
        judgement = Judgement(
            what=what,
            seeds=each,
            start=a,
            start_se=a_se,
            tuned=b,
            tuned_se=b_se,
            difference=sign * float(pair["mean_diff"]),
            difference_se=float(pair["se"]),
            diverged=(int(bad), int(worse)),
        )
        out.append(judgement)
    return out


def against(judged: list[Judgement]) -> str:
    """Return why what was found is not used (worse than its start on the validation runs); empty where it is."""
    (j,) = (each for each in judged if each.what == "validation")
    if j.diverged[1] > j.diverged[0]:
        return f"{j.diverged[1]} of {j.seeds.many} validation runs diverge, {j.diverged[0]} with the start"
    if j.difference != j.difference:
        return f"{j.diverged[1]} of {j.seeds.many} validation runs diverge, as with the start"
    if not j.difference <= WORSE * j.difference_se:
        return (
            f"worse than its start on the validation runs by {j.difference:.3g} (standard error {j.difference_se:.2g})"
        )
    return ""


def only(study: Study, observer: str) -> list[str] | None:
    """Return the options of an observer that are tuned; None: all that may be."""
    may = parameters.tunable(entry_in(study, observer))
    return None if study.tune.only is None else [name for name in study.tune.only if name in may]


def require_tunable(study: Study, observers: list[str]) -> None:
    """Raise UserError where a name of `tune.only` is of an option that no observer of the study tunes."""
    may = {name: None for o in observers for name in parameters.tunable(entry_in(study, o))}
    for name in study.tune.only or ():
        if name not in may:
            raise unknown(f"{study.name}: tune.only", "option that an observer of the study tunes", name, [*may])


def require_free_labels(study: Study, scenario: Scenario, observers: list[str]) -> None:
    """Raise UserError where the scenario has options for a version's label: they would be taken for its own."""
    for observer in observers if len(study.tunings) > 1 else ():
        if taken := [label for t in study.tunings if (label := f"{observer}-{t}") in scenario.options]:
            raise UserError(
                f"{study.name}: tuning: got {taken[0]} for gains of {observer}, expected a label that {scenario.name} has no "
                f"options for; run {observer} under another label."
            )
