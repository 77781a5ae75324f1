"""Validation of a tuning: start and tuned gains on the training runs and on other runs, by the numbers of the tables.

Also checks of a study's `tune.only`, and of the labels of its versions.
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

MAX_WORSE = 2.0  # standard errors by which the tuned gains may be worse than the start


def judge(
    study: Study, observer: str, tuned_options: TomlTable, aim: Objective, seeds: dict[str, Seeds]
) -> list[Judgement]:
    """Run start and tuned gains with the same seeds, for each range of seeds."""
    base = base_of(observer) or observer
    current = merge_options(study, scenarios_of(study)[study.scenarios[0]], observer)
    labels = f"{base}-start", f"{base}-tuned"
    options = {k: v for k, v in study.options.items() if k != observer or k == base}
    options |= {labels[0]: current, labels[1]: current | tuned_options}
    metric, out = POOLED.get(aim.metric, aim.metric), []
    for kind, span in seeds.items():
        changes = {"observers": list(labels), "options": options, "first_seed": span.first, "seeds": span.many}
        result = run_study.execute(parse.grid_of(study, changes, []))
        stats = result.stats[(result.stats.signal == aim.name) & (result.stats.metric == metric)].set_index("observer")
        (pair,) = result.pairs[(result.pairs.signal == aim.name) & (result.pairs.metric == metric)].to_dict("records")
        sign = 1.0 if pair["observer_a"] == labels[1] else -1.0
        (a, a_se, bad), (b, b_se, worse) = stats.loc[list(labels), ["mean", "se", "diverged"]].to_numpy().tolist()
        judgement = Judgement(
            what=kind,
            seeds=span,
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


def rejection_reason(judgements: list[Judgement]) -> str:
    """Return why the tuned gains are rejected (worse than the start on the validation runs); empty if they are not."""
    (j,) = (judgement for judgement in judgements if judgement.what == "validation")
    if j.diverged[1] > j.diverged[0]:
        return f"{j.diverged[1]} of {j.seeds.many} validation runs diverge, {j.diverged[0]} with the start"
    if j.difference != j.difference:
        return f"{j.diverged[1]} of {j.seeds.many} validation runs diverge, as with the start"
    if not j.difference <= MAX_WORSE * j.difference_se:
        return (
            f"worse than its start on the validation runs by {j.difference:.3g} (standard error {j.difference_se:.2g})"
        )
    return ""


def tune_only(study: Study, observer: str) -> list[str] | None:
    """Return the options of an observer that are tuned; None: all tunable ones."""
    tunable = parameters.tunable(entry_in(study, observer))
    return None if study.tune.only is None else [name for name in study.tune.only if name in tunable]


def require_tunable(study: Study, observers: list[str]) -> None:
    """Raise UserError for a name of `tune.only` that is not a tunable option of any observer of the study."""
    tunable = {name: None for o in observers for name in parameters.tunable(entry_in(study, o))}
    for name in study.tune.only or ():
        if name not in tunable:
            raise unknown(f"{study.name}: tune.only", "option that an observer of the study tunes", name, [*tunable])


def require_free_labels(study: Study, scenario: Scenario, observers: list[str]) -> None:
    """Raise UserError if the scenario has options for the label of a version, which would override its own."""
    for observer in observers if len(study.tunings) > 1 else ():
        if conflicts := [label for t in study.tunings if (label := f"{observer}-{t}") in scenario.options]:
            raise UserError(
                f"{study.name}: tuning: got {conflicts[0]} for gains of {observer}, expected a label that {scenario.name} has "
                f"no options for; run {observer} under another label."
            )
