"""`pcbench design`: gains, certificate, what is promised; as TOML that runs; trade-offs; one sentence for every mistake."""

import json
import tomllib

import jax
import numpy as np
import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench.errors import UserError
from pcbench.gains import design
from pcbench.observers import OBSERVERS
from pcbench.runtime import config
from pcbench.study import parse

IN = {
    "chain": "csth/10s-noise",
    "equal-delay": "csth/10s-noise",
    "no-delay": "csth/10s-noise",
    "smo": "arm/sampled",
    "pio": "arm/sampled",
    "high-gain": "helicopter/constant",
    "cascade-predictor": "cart/gaussian",
    "cdob": "cart/gaussian",
    "lmi-sampled": "ncs-two-state/held",
    "ekf-delay": "cart/unknown-delay",
    "mmae-delay": "cart/unknown-delay",
}
PROMISES = {
    "pccebo",
    "kfbo",
    "pco",
    "pi-pco",
    "chain",
    "smo",
    "pio",
    "eso",
    "cascade-predictor",
    "finite-time",
    "interval",
}  # no-delay diverges there, kf's gain varies in time


ALWAYS = ("rate", "margin", "solver", "fallback", "certified", "refused")  # columns of a trade-off


def design_study(observer, scenario, **how):
    with config.float64():
        study, cell, found = design.design(scenario, observer, **how)
        return design.as_study(study, cell, observer, found), found


@pytest.mark.parametrize("observer", OBSERVERS)
def test_every_design_says_what_it_promises_and_can_be_read_back(observer, tmp_path):
    scenario = IN.get(observer, "cart/variable")
    scenario = "cart/gaussian" if observer == "kfbo" else scenario
    table, found = design_study(observer, scenario)
    assert bool(np.isfinite(found.certificate.rate)) == (observer in PROMISES)
    assert found.certificate.rate > 0 or not np.isfinite(found.certificate.rate)
    path = tmp_path / "design.toml"
    path.write_text(design.to_toml(table))
    proof = tomllib.loads(path.read_text())["resolved"]["certificate"]
    proven = proof.pop("certified", None)
    unproven = (
        "ekf",
        "high-gain",
        "high-gain-predictor",
        "super-twisting",
        "cdob",
        "no-delay",
        "kf-event",
        "kf-ignore-delay",
        "kf-shifted-innovation",
        "kf-larsen",
        "kf-alexander",
    )
    unproven += ("ekf-iterated", "ukf", "mhe", "particle", "ekf-delay", "mmae-delay")
    assert proven == (None if observer == "model-only" else observer not in unproven), "in the files as well"
    assert set(proof) == {"inequality", "margin", "solver", "status", "fallback", "decay_rate"}
    again = pcbench.design(path, observer)
    same(found, again)


def same(a, b):
    for x, y in zip(jax.tree.leaves(a.gains), jax.tree.leaves(b.gains), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-300)


WAYS = [
    ("pccebo", "cart/gaussian", "riccati", {}),
    ("pccebo", "cart/gaussian", "h2", {"decay": 1.0}),
    ("pccebo", "cart/gaussian", "hinf", {"decay": 0.5, "period_range": [0.5, 0.7]}),
    ("pccebo", "cart/variable", "decay", {"period_range": [0.1, 0.3]}),
    ("chain", "csth/10s-noise", "riccati", {}),
    ("smo", "arm/sampled", "design", {}),
]


@pytest.mark.ci
@pytest.mark.parametrize(("observer", "scenario", "method", "options"), WAYS)
def test_a_design_by_a_method_runs_with_the_numbers_that_were_found(observer, scenario, method, options):
    changes = [f"options.{observer}.{name}={value}" for name, value in options.items()]
    table, found = design_study(observer, scenario, gain=method, overrides=changes)
    again = pcbench.design({k: v for k, v in table.items() if k != "resolved"}, observer)
    same(found, again)
    if "decay" in options:
        assert again.certificate.rate >= 0.999 * options["decay"]
    assert found.certificate.rate > 0


def test_a_design_that_is_read_back_promises_nearly_the_decay_that_was_asked_and_keeps_other_options():
    changes = ["options.pccebo.decay=1.0", "options.scenario.initial_spread=0.2", "options.kf.R=3.0"]
    table, _ = design_study("pccebo", "cart/gaussian", gain="h2", overrides=changes)
    assert table["options"]["pccebo"]["decay"] == pytest.approx(0.999)
    assert set(table["options"]["pccebo"]) >= {"L", "decay"}
    assert table["options"]["scenario"] == {"initial_spread": 0.2}
    assert table["options"]["kf"] == {"R": 3.0}


def test_a_trade_off_shows_gains_and_noise_and_not_what_proves_them():
    table = pcbench.trade_off("cart/gaussian", "pccebo", "q", [0.01, 1.0], gain="riccati")
    numbers = [name for name in table.columns if name not in ("q", *ALWAYS)]
    assert [name for name in numbers if not name.startswith("eigenvalues")] == [
        "L[0]",
        "L[1]",
        "noise_rms[0]",
        "noise_rms[1]",
    ]
    for value, row in zip((0.01, 1.0), table.to_dict("records"), strict=True):
        found = pcbench.design("cart/gaussian", "pccebo", gain="riccati", overrides=[f"options.pccebo.q={value}"])
        assert [row["L[0]"], row["L[1]"]] == found.gains.L[:, 0].tolist()


@pytest.mark.ci
def test_the_command_writes_a_study_that_runs_and_says_what_is_promised(tmp_path):
    out = tmp_path / "folder" / "h2.toml"
    words = [
        "design",
        "cart/gaussian",
        "pccebo",
        "--gain",
        "h2",
        "--set",
        "options.pccebo.decay=1.0",
        "--out",
        str(out),
    ]
    done = call(*words)
    assert "decay rate of the errors: 1 1/s or faster" in done.stdout, done.stderr
    assert f"pcbench run {out}" in done.stdout.replace("\n", "")
    result = pcbench.run(out, seeds=4)
    assert set(result.stats.observer) == {"pccebo"}
    said = json.loads(call(*words, "--json").stdout)
    assert said["solver"] == "CLARABEL"
    assert said["fallback"] == ""
    assert said["rate"] == pytest.approx(1.0, rel=1e-4)
    assert "cart/gaussian-pccebo" in out.read_text()


@pytest.mark.nightly
def test_a_trade_off_is_a_row_for_each_value_and_says_what_is_refused(tmp_path):
    out = tmp_path / "curve.parquet"
    words = ["design", "cart/gaussian", "pccebo", "--gain", "h2", "--sweep", "decay=0.5,1,1000"]
    done = call(*words, "--out", str(out))
    assert "expected 20 at most" in done.stdout.replace("\n", " "), done.stderr
    table = pd.read_parquet(out)
    assert list(table.decay) == [0.5, 1.0, 1000.0]
    assert list(table.refused == "") == [True, True, False]
    assert table["noise_rms[0]"][1] > table["noise_rms[0]"][0]
    rows = json.loads(call(*words, "--json").stdout)
    assert [row["decay"] for row in rows] == [0.5, 1, 1000]
    ranges = pcbench.trade_off("cart/gaussian", "pccebo", "period-range", [[0.5, 0.7], [0.1, 1.0]], gain="decay")
    assert ranges.rate[0] > ranges.rate[1] > 0
    with pytest.raises(UserError, match="expected 20 at most"):
        pcbench.trade_off("cart/gaussian", "pccebo", "decay", [1000.0], gain="h2")


TRADES = {
    "pco": ("cart/variable", "decay", [0.0, 1.0], {"Kp": "lmi"}, "rate"),
    "pi-pco": ("cart/variable", "decay", [0.0, 2.0], {"Kp": "lmi", "Ki": "lmi"}, "rate"),
    "smo": ("arm/sampled", "alpha", [0.5, 1.0], {"gains": "design"}, "r"),
    "pio": ("arm/sampled", "beta", [0.5, 1.0], {"gains": "design"}, "g"),
}


@pytest.mark.parametrize("observer", TRADES)
def test_a_faster_promise_costs_something(observer):
    scenario, option, values, options, cost = TRADES[observer]
    study = parse.grid_of(scenario, {"options": {observer: options}}, []).study
    table = pcbench.trade_off(study, observer, option, values)
    assert table.rate[1] > table.rate[0]
    assert table[cost][1] > table[cost][0]
    assert table.rate[1] >= values[1] * (1 - 1e-5)


MISTAKES = {
    ("--gain", "beauty"): "'beauty' is no design method of pccebo; did you mean 'decay'?",
    ("--sweep", "decay"): "expected OPTION=A,B,...",
    ("--sweep", "beauty=1,2"): "'beauty' is no option",
    ("--set", "options.pccebo.period-range=[3.0,1.0]"): "expected a range: [lowest, highest]",
    ("--set", "options.pccebo.parameter-range={mass=[1.0,2.0]}"): "'mass' is no parameter of plant cart",
    ("--set", "options.pccebo.parameter-range={lam=3}"): "parameter_range.lam: got 3, expected a valid list",
    ("--set", "options.pccebo.period-range=[0.0001,0.0002]"): "expected one with a multiple of the tick",
    ("--gain", "riccati", "--set", "options.pccebo.decay=1.0"): "errors decay at 0.168 1/s",
    ("--out", "/proc/none/x.toml"): "/proc/none",
}


@pytest.mark.ci
@pytest.mark.parametrize("words", MISTAKES, ids=" ".join)
def test_mistakes_are_one_sentence(words, tmp_path):
    done = call("design", "cart/gaussian", "pccebo", *words, cwd=tmp_path)
    assert done.returncode == 2, done.stdout
    assert MISTAKES[words] in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert not list(tmp_path.iterdir())


def test_an_observer_with_one_way_says_so():
    done = call("design", "cart/gaussian", "kf", "--gain", "h2")
    assert done.returncode == 2
    assert "kf has one design method; leave it out" in done.stderr


def test_a_sweep_of_what_the_gains_do_not_come_from_says_so():
    done = call("design", "arm/sampled", "smo", "--sweep", "alpha=0.5,1")
    assert "alpha has no effect here" in done.stdout, done.stderr
