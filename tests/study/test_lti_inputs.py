"""Inputs of a plant of one's own: waves, values, rows and files against their formulas, jumps, and what does not fit."""

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w
from commands import call

import pcbench
from pcbench.errors import UserError
from pcbench.scenarios import signals
from pcbench.scenarios.sources import Table, Wave

pytestmark = pytest.mark.usefixtures("in_a_hurry")

TICK, TICKS = 0.01, 100
T = TICK * np.arange(TICKS + 1)
PLANT = {
    "A": [[0.0, 1.0], [-4.0, -0.5]],
    "B": [[0.0, 1.0], [2.0, 0.0]],
    "C": [[1.0, 0.0]],
    "sampling_period": 0.05,
    "delay": 0.02,
    "noise_std": 0.1,
    "tick": TICK,
    "duration": TICK * TICKS,
}


def study(**changes):
    return {"name": "own", "lti": PLANT | changes, "observers": ["kf"]}


def driven(given):
    return pcbench.simulate(study(input=given), ["kf"])[["u1", "u2"]].to_numpy()


SINE = {"signal": "sine", "amplitude": 2.0, "frequency": 1.5, "offset": 1.0, "phase": 0.7}
SAID = {
    "a wave": (SINE, np.stack([1 + 2 * np.sin(3 * np.pi * T + 0.7)] * 2, 1)),
    "two": ([{"signal": "square", "frequency": 2.5}, "sine"],
            np.stack([[1.0 if k // 20 % 2 == 0 else -1.0 for k in range(101)], np.sin(4 * T)], 1)),
    "saw teeth": ([{"signal": "sawtooth", "frequency": 1.0, "amplitude": 3.0}, {"signal": "rising", "frequency": 2.0}],
                  np.stack([3 - 6 * (np.arange(101) % 100) / 100, (np.arange(101) % 50) / 25 - 1], 1)),
    "a step": ({"signal": "step", "amplitude": 2.0, "offset": -0.5}, np.full((101, 2), 1.5)),
    "each tick": ((T**2).tolist(), np.stack([T**2] * 2, 1)),
    "rows": ([[0.1, 1.0, -1.0], [0.5, 2.0, -3.0]],
             np.where(T[:, None] < 0.095, 0, np.where(T[:, None] < 0.495, [1, -1], [2, -3]))),
    "names": ("sine, square", np.stack([np.sin(4 * T), np.ones(101) - 2 * (T > 0.995)], 1)),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("what", SAID)
def test_an_input_is_what_the_study_says(what):
    given, want = SAID[what]
    np.testing.assert_allclose(driven(given), want, rtol=0, atol=1e-6 if what == "saw teeth" else 1e-12)


@pytest.mark.ci
def test_a_file_stands_beside_the_study_and_its_rows_in_what_is_left(tmp_path, monkeypatch):
    rows = [[0.0, 1.0, 2.0], [0.25, -1.0, 0.5]]
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "volts.csv").write_text("t,u1,u2\n" + "\n".join(", ".join(map(str, row)) for row in rows) + "\n")
    path = tmp_path / "a" / "own.toml"
    path.write_text(tomli_w.dumps(study(input="volts.csv") | {"seeds": 4}))
    d = pcbench.simulate(path, ["kf"])
    np.testing.assert_array_equal(d[["u1", "u2"]].to_numpy(), driven(rows))
    pcbench.run(path, out=tmp_path / "out")
    (tmp_path / "a" / "volts.csv").unlink()
    assert pcbench.run(tmp_path / "out" / "study.toml", out=tmp_path / "out").cost.runs == 0, (
        "the file is not needed again"
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here.csv").write_text("t,u1\n0,3\n")
    np.testing.assert_array_equal(driven("here.csv"), np.full((101, 2), 3.0))


@pytest.mark.ci
def test_a_changed_file_is_another_study(tmp_path):
    file = tmp_path / "volts.csv"
    file.write_text("t,u1\n0,3\n")
    pcbench.run(study(input=str(file)), seeds=4, out=tmp_path / "out")
    file.write_text("t,u1\n0,4\n")
    with pytest.raises(UserError, match="input"):
        pcbench.run(study(input=str(file)), seeds=4, out=tmp_path / "out")


@pytest.mark.nightly
def test_an_unknown_input_is_said_likewise_and_its_unit_is_the_signals():
    given = {"signal": "square", "frequency": 2.0, "amplitude": 0.5, "unit": "m/s^2"}
    pushed = study(E=[[0.0], [1.0]], unknown_input=given)
    d = pcbench.simulate(pushed, ["kf"])
    np.testing.assert_array_equal(d["input"], [0.5 if k // 25 % 2 == 0 else -0.5 for k in range(101)])
    stats = pcbench.run(pushed, seeds=4).stats
    assert set(stats[(stats.signal == "input") & (stats.metric == "mae")].unit) == {"m/s^2"}
    assert stats[stats.metric == "recovery_time"]["mean"].notna().any(), "it is known where the input jumps"


@pytest.mark.ci
def test_a_trace_says_the_unit_of_the_input_and_whether_gains_are_certified(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(tomli_w.dumps(study(input=[SINE | {"unit": "V"}, "sine"])))
    call("simulate", str(path), "--observer", "kf", "--out", str(tmp_path / "t.parquet"))
    schema = pq.read_schema(tmp_path / "t.parquet")
    said = [schema.field(name).metadata[b"unit"].decode() for name in ("u1", "u2")]
    assert said == ["V", "unit of the input"]
    proven = [field.metadata.get(b"certified") for field in schema if field.name.startswith("kf.")]
    assert set(proven) == {b"true"}


@pytest.mark.parametrize(
    ("wave", "want"),
    [
        (Wave("square", frequency=2.0), [25, 50, 75, 100]),
        (Wave("sawtooth", frequency=2.0), [50, 100]),
        (Wave("rising", frequency=3.0, phase=np.pi), [17, 50, 84]),
        (Wave("sine", frequency=2.0), []),
        (Wave("step"), []),
        (Table((0.0, 0.5), ((1.0,), (2.0,))), []),
    ],
)
def test_a_wave_jumps_where_its_values_do(wave, want):
    np.testing.assert_array_equal(signals.jumps((wave,), TICK, TICKS), want)
    u = signals.inputs((wave,), T, 1)[:, 0]
    far = np.flatnonzero(np.abs(np.diff(u)) > 0.5) + 1
    if isinstance(wave, Wave):
        np.testing.assert_array_equal(far, want)


BAD = {
    "a number": (2.0, r"lti\.input: got 2\.0, expected a signal's name, a table such as"),
    "an empty list": ([], r"lti\.input: got \[\], expected a signal's name"),
    "no name": ("cosine", r"lti\.input: 'cosine' is no input; did you mean 'sine'"),
    "no shape": ({"amplitude": 2.0}, r"lti\.input\.signal is missing; write signal = one of"),
    "no such shape": ({"signal": "cosine"}, r"lti\.input\.signal: 'cosine' is no shape of a signal; did you mean 'sine'"),
    "no key": (SINE | {"ampitude": 1.0}, r"lti\.input: 'ampitude' is no key of a signal; did you mean 'amplitude'"),
    "a text": (SINE | {"amplitude": "2"}, r"lti\.input\.amplitude: got '2', expected a finite number"),
    "no frequency": ({"signal": "sine"}, r"lti\.input: got a sine without a frequency, expected one; write frequency"),
    "a frequency below 0": (SINE | {"frequency": -1.0}, r"lti\.input\.frequency: got -1\.0, expected a number of at least 0"),
    "a step's": ({"signal": "step", "phase": 1.0}, r"lti\.input: got a step with a frequency or a phase, expected neither"),
    "a unit": (SINE | {"unit": 1.0}, r"lti\.input\.unit: got 1\.0, expected a text such as 'V'"),
    "three": (["sine"] * 3, r"lti\.input: got 3 signals, expected one, or one for each of 2 inputs"),
    "too few": ([1.0, 2.0], r"lti\.input: got 2 numbers, expected 100, one for each tick of 0\.01 s; write rows \[t, u\]"),
    "a text among them": ([1.0, "2"], r"lti\.input\[1\]: got '2', expected a finite number"),
    "rows of three inputs": ([[0.0, 1.0, 2.0, 3.0]], r"lti\.input\[0\]: got .*, expected a row of t and 1 or 2 numbers"),
    "ragged rows": ([[0.0, 1.0, 2.0], [1.0, 1.0]], r"lti\.input\[1\]: got \[1\.0, 1\.0\], expected a row of t and 1 or 2"),
    "a time twice": ([[0.0, 1.0], [0.0, 2.0]], r"lti\.input\[1\]: got t = 0 s after 0 s, expected times that grow"),
    "no file": ("gone.csv", r"lti\.input: got 'gone\.csv', expected a CSV file that can be read \(No such file"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_what_does_not_fit_is_named_in_one_sentence_and_nothing_is_written(what, tmp_path):
    given, sentence = BAD[what]
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study(input=given), seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "it is no table with a head"),
        ("a,b\n0,1\n", "first line is t,u1"),
        ("t,u1\n0,x\n", "with 2 numbers in line 2"),
        ("t,u1\n0,1\n1\n", "with 2 numbers in line 3"),
        ("t,u1\n1,1\n0,2\n", r"input\[1\]: got t = 0 s after 1 s"),
        ("t,u1\n0,nan\n", r"input\[0\]\[1\]: got nan, expected a finite number"),
        ("t,u1\n", "expected a signal's name"),
    ],
)
def test_a_file_that_is_no_table_of_inputs_is_refused_in_one_sentence(text, sentence, tmp_path):
    file = tmp_path / "volts.csv"
    file.write_text(text)
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study(input=str(file)), seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
