"""The pages on standard examples: their tables name what exists, numbers are in the ledger, findings come out."""

import re
from pathlib import Path

import numpy as np
import pytest
from reference import linear

import pcbench
from pcbench.scenarios import SCENARIOS
from pcbench.study.builtin import STUDIES

GUIDE = Path(pcbench.__file__).parent / "guide"
PAGE = "\n".join((GUIDE / name).read_text() for name in ("the_field.md", "field_findings.md"))
SIGNALS = ("inorganic_nitrogen", "biomass")
LEDGER = (Path(__file__).parents[2] / "REPRODUCTION.md").read_text().partition("\n## field\n")[2]


def rows(heading):
    """The cells of the table whose head begins so, as lists."""
    table = PAGE.partition(f"\n| {heading}")[2].partition("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_every_study_and_scenario_of_the_tables_exists():
    studies = [re.findall(r"`([\w-]+)`", row[2]) for row in rows("example | question")]
    named = [re.findall(r"`([\w/-]+)`", row[1]) for row in rows("example | scenarios")]
    assert len(studies) == 12
    assert {name for study in studies for name in study} <= STUDIES.keys()
    assert {name for each in named for name in each} <= SCENARIOS.keys()
    families = {name.split("/")[0] for each in named for name in each}
    assert families == {
        "ncs-two-state",
        "ncs-reactor",
        "intermittent",
        "quadruple-tank",
        "flexible-joint",
        "growth-model",
        "falling-body",
        "coordinated-turn",
        "digester",
        "double-well",
        "camera-target",
    }


def test_every_number_to_check_is_in_the_ledger():
    for row in rows("example | question"):
        for number in re.findall(r"-?\d+\.\d\d+", row[3]):
            assert number in LEDGER, number


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("study", "metric", "signal", "heading"),
    [
        ("quadruple-tank", "steady_pooled_rmse", "level_2", "delay [s] | `kf`"),
        ("ncs-two-state", "steady_rmse", "position", "period [s] | estimate"),
        ("ncs-two-state", "steady_tracking_rmse", "position", "period [s] | estimate"),
    ],
)
def test_findings_of_the_page_come_out(study, metric, signal, heading):
    stats = pcbench.run(study).stats
    stats = stats[(stats.metric == metric) & (stats.signal == signal)]
    for first, *shown in rows(heading):
        if study == "quadruple-tank":
            delays = stats.delay.map(lambda delay: delay[1])
            at = stats[(stats.scenario == "quadruple-tank/delayed") & (delays == float(first))]
            found = at.set_index("observer").loc[["kf", "kf-ignore-delay", "model-only"]]
        else:
            found = stats[stats.scenario == f"period-{float(first):g}"]
            shown = [shown[metric == "steady_tracking_rmse"]]
        for text, (_, row) in zip(shown, found.iterrows(), strict=True):
            assert float(text) == pytest.approx(row["mean"], abs=3 * row["se"] + 0.05 * row["mean"])


@pytest.mark.nightly
def test_errors_of_the_flexible_joint_come_out():
    stats = pcbench.run("flexible-joint").stats
    stats = stats[(stats.metric == "steady_rmse") & (stats.signal == "link_angle")]
    found = stats.set_index(["observer", "sampling_period"])["mean"]
    for period, *shown in rows("period [s] | `ekf`"):
        for observer, text in zip(("ekf", "lmi-sampled"), shown, strict=True):
            assert float(text) == pytest.approx(found[observer, float(period)], rel=0.03)
    assert found["model-only"].iloc[0] == pytest.approx(0.46, abs=0.005)


@pytest.mark.ci
def test_gain_of_the_flexible_joint_is_certified_and_stable_up_to_the_limit_of_the_page():
    options = STUDIES["flexible-joint"].options["lmi-sampled"]
    study = {"name": "joint", "scenario": {"base": "flexible-joint/sampled"}, "options": {"lmi-sampled": options}}
    made = pcbench.design(study, "lmi-sampled")
    assert made.certificate.margin > 0

    def radius(period):
        maps = []
        for slope in (-3.33, 0.0, 3.33):
            A = np.array([[0, 1, 0, 0], [-48.6, -1.25, 48.6, 0], [0, 0, 0, 1], [19.5, 0, -19.5 - slope, 0]])
            Phi, Gamma = linear.discretise(A, -made.gains.L, period)
            maps.append(np.abs(np.linalg.eigvals(Phi + Gamma @ np.eye(4)[:1])).max())
        return max(maps)

    assert max(map(radius, np.linspace(0.05, 0.455, 30))) < 1 < radius(0.47)
    assert radius(0.5) > 1


@pytest.mark.nightly
def test_errors_of_the_digester_come_out():
    stats = pcbench.run("digester").stats
    stats = stats[stats.metric == "steady_pooled_rmse"]
    hours = stats.delay.map(lambda delay: delay[5] / 3600)
    shown = {name.strip("`"): values for name, *values, _ in rows("observer | 0 h")}
    for i, hour in enumerate((0, 7, 21)):
        here = stats[hours == hour]
        nitrogen, biomass = (here[here.signal == signal].set_index("observer")["mean"] for signal in SIGNALS)
        assert shown.keys() == set(nitrogen.index)
        for observer, values in shown.items():
            assert float(values[i]) == pytest.approx(nitrogen[observer], rel=0.01)
        assert biomass.min() > 0.975 * biomass["model-only"]


@pytest.mark.ci
def test_operations_of_the_digester_come_out():
    costs = pcbench.operation_counts("digester").query("cell == 3").set_index("observer")["sample"]
    assert {name.strip("`"): int(count) for name, *_, count in rows("observer | 0 h")} == costs.to_dict()


@pytest.mark.nightly
def test_errors_of_the_falling_body_come_out():
    result = pcbench.run("falling-body")
    stats = result.stats.query("metric == 'steady_rmse' and signal == 'altitude'").set_index(["observer", "delay"])
    runs = result.runs.query("signal == 'altitude'").groupby(["observer", "delay"])
    for first, *shown in rows("delay [s] | `ukf` | `ekf` | diverged"):
        for observer, error, diverged in zip(("ukf", "ekf"), shown[:2], shown[2:], strict=True):
            at = observer, float(first)
            mean, half = (float(number) for number in error.split(" ± "))
            assert mean == pytest.approx(stats.loc[at, "mean"], abs=0.06 * half + 0.5)
            assert half == pytest.approx((stats.loc[at, "ci_high"] - stats.loc[at, "ci_low"]) / 2, abs=0.51)
            assert int(diverged) == pytest.approx(runs.get_group(at).diverged.sum(), abs=1)


@pytest.mark.nightly
def test_errors_of_the_coordinated_turn_come_out():
    runs = pcbench.run("coordinated-turn").runs
    runs = runs[runs.signal == "position"].set_index(["observer", "delay"])
    for delay, ukf, ekf, lost in rows("delay [s] | `ukf`, cubature"):
        kept = runs.loc[("ekf", float(delay))]
        assert int(lost) == pytest.approx((kept.steady_max_abs_error > 500).sum(), abs=1)
        kept = kept[kept.steady_max_abs_error <= 500]
        for text, each in ((ukf, runs.loc[("ukf", float(delay))]), (ekf, kept)):
            assert float(text.split()[0]) == pytest.approx(each.steady_mse.mean() ** 0.5, rel=0.01)


@pytest.mark.nightly
def test_errors_of_the_camera_come_out():
    stats = pcbench.run("camera-target").stats
    stats = stats[(stats.metric == "steady_tracking_rmse") & (stats.signal == "offset")]
    assert (stats.ci_high - stats.ci_low < 0.21 * stats["mean"])[stats["mean"].notna()].all()
    delays = stats.delay.map(lambda delay: delay[0])
    reductions = []
    for first, *shown in rows("delay [s] | servo"):
        here = stats[delays == float(first)].set_index(["observer", "scenario"])["mean"].unstack()
        best = here[["servo-2", "servo-4", "servo-8"]].min(axis=1)
        values = [best["kf-ignore-delay"], best["kf"], here.following["kf"]]
        for text, value in zip(shown, values, strict=True):
            assert float(text) == pytest.approx(value, abs=5.1e-4)  # to the printed digit
        reductions.append(round(100 * (1 - values[2] / values[0])))
        diverged = {name for name, value in here.loc["kf-ignore-delay"].items() if value != value}
        assert diverged == ({"following", "servo-8"} if float(first) >= 0.2 else set())
    assert "is {}, {} and {} % smaller".format(*reductions) in PAGE
