"""Numbers in the terminal: every number of a table is printed whole at any width, piped or not."""

import io
import math
import re
from collections import Counter
from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text

import pcbench
from pcbench.checking.targets import Finding
from pcbench.cli.render import folder, gains, limits, recordings, results
from pcbench.cli.render.tables import Column, Screen
from pcbench.dataset.verify import Share, Status
from pcbench.papers.claim import REPRODUCED, Claim
from pcbench.statistics import number_format

WIDTHS = [60, 80, 100, 200]
ANSI = re.compile(r"\x1b\[[0-9;]*m")
NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")
POWER = re.compile(r"\(([-+.\d]+)\s*±\s*([.\d]+)\)(e[-+]\d+)")  # of a value with its interval
OBSERVERS = ["kf-shifted-innovation", "ekf-iterated", "pccebo", "kf"]
RNG = np.random.default_rng(3)


class Recorder(Screen):
    """A terminal that keeps the tables that it is given."""

    def __init__(self, width, terminal):
        super().__init__(file=io.StringIO(), width=width, force_terminal=terminal, color_system="truecolor")
        self.tables, self.said = [], []

    def fit(self, title, columns, *given, **named):
        out = super().fit(title, columns, *given, **named)
        self.tables.append((columns, out))
        return out

    def say(self, *sentences):
        """Keep sentences that the terminal breaks."""
        self.said += sentences
        super().say(*sentences)

    @property
    def text(self):
        return ANSI.sub("", self.file.getvalue())


def words(cell):
    return Counter((cell.plain if isinstance(cell, Text) else cell).split())


def require_whole(screen):
    """Compare each word of each cell with the words that are printed; columns that are left out are named."""
    text, printed = screen.text, Counter(screen.text.split())
    assert "…" not in text
    assert all(len(line.rstrip()) <= screen.width or line in screen.said for line in text.splitlines())
    given = Counter()
    for columns, out in screen.tables:
        heads = [c.head.replace("\n", " ") for c in columns]
        assert set(out) <= set(heads)
        for head in out:
            assert head in " ".join(text.partition("Left out for lack of space: ")[2].split())
        for column, head in zip(columns, heads, strict=True):
            given += sum((words(cell) for cell in column.cells), Counter()) if head not in out else Counter()
    assert not given - printed


def require_numbers(screen, values):
    """Find each number of a table of numbers among those that are printed, to at least three digits."""
    text = POWER.sub(r"\1\3 ± \2\3", screen.text)
    found = [number.replace(",", "") for number in NUMBER.findall(text)]
    printed = [(float(text), digits(text)) for text in found]
    for value in values:
        near = [1 for number, last in printed if abs(number - value) <= max(0.51 * 10.0**last, 5e-3 * abs(value))]
        assert near or value != value, value


def digits(text):
    """Return the power of ten of the last digit of a number."""
    body, _, power = text.partition("e")
    return -len(body.partition(".")[2]) + int(power or 0)


def sizes(*shape):
    return np.exp(RNG.normal(0.0, 6.0, shape))


def status_table(screen):
    shares = [Share("coordinated-turn/outages", o, 12, 1234, 1_234_567, 2_345_678, None) for o in OBSERVERS]
    folder.status(Status("study", shares, [], [], [], 123_456_789, True), "results/study", screen)
    return [12, 1234, 1_234_567, 2_345_678, 123.5]


def comparison_table(screen):
    rows = pd.DataFrame({"scenario": "cart/gaussian-fast", "where": "delay=0.2, noise_std=0.1", "observer": OBSERVERS})
    rows = rows.assign(
        signal="angular_velocity", metric="steady_pooled_rmse", unit="rad/s", changed=True, identical=False
    )
    rows = rows.assign(same_draws=True, narrowed=False, certified_a=True, certified_b=None, relative=0.5)
    for name in ("mean_a", "mean_b", "difference", "p_holm"):
        rows[name] = sizes(len(rows))
    for side in "ab":
        rows[f"se_{side}"] = rows[f"mean_{side}"] / 50
    found = SimpleNamespace(rows=rows, made_by=[], only=(0, 0), identical=False, largest=0.5, changed=4)
    folder.comparison(found, "results/a", "results/b", screen)
    return [*rows.mean_a, *rows.mean_b, *rows.difference]


def claims_table(screen):
    rows = [
        Claim("Table 2: rms error of the tip of the flexible arm", "0.123456 ± 0.000012 m", "0.123457 m", REPRODUCED)
    ]
    folder.claims("A paper", [row._replace(printed=f"{v:.6g} m") for row in rows for v in VALUES], screen)
    return VALUES


VALUES = [0.123456, 123456.0, 1.23457e-9]


def limits_table(screen):
    rows = pd.DataFrame(
        {"observer": OBSERVERS, "largest": [0.12345, 0.25, 0.5, 0.75], "exceeds": [0.13, 0.26, 0.51, 0.8]}
    )
    for name in ("", "exceeds_"):
        rows[f"{name}mean"] = sizes(4)
        rows[f"{name}ci_low"], rows[f"{name}ci_high"] = rows[f"{name}mean"] * 0.95, rows[f"{name}mean"] * 1.05
    rows = rows.assign(answer="up to", sentence="")
    about = {"unit": "rad/s", "over_unit": "s", "metric": "steady_pooled_rmse", "below": 0.05, "between": (0.0, 1.0)}
    rows.attrs = about | {
        "title": "cart/white",
        "signal": "angular_velocity",
        "over": "sampling_period",
        "notes": [],
    }
    limits.answers(rows, screen)
    return [*rows.largest, *rows.exceeds] + ([*rows["mean"], *rows.exceeds_mean] if screen.width == 200 else [])


def frontier_table(screen):
    pairs = list(product(OBSERVERS, [0.1, 0.2, 0.4]))
    rows = pd.DataFrame(pairs, columns=["observer", "sampling_period"]).assign(answer="up to", sentence="")
    rows["largest"] = np.linspace(0.012345, 0.9, len(rows)).round(6)
    rows.attrs = {
        "unit": "m",
        "metric": "rmse",
        "below": 0.05,
        "over": ("sampling_period", "delay"),
        "over_unit": ("s", "s"),
    }
    rows.attrs |= {"title": "cart/white", "signal": "position", "notes": []}
    limits.frontier(rows, screen)
    return rows.largest


def channels_table(screen):
    names = ["samples", "lost", "rate", "delay_p05", "delay_p95", "delay_median", "delay_most", "drift_ppm"]
    rows = pd.DataFrame(sizes(3, len(names)), columns=names).assign(
        channel=["imu/angular_velocity", "gps", "camera/pose"]
    )
    rows[["samples", "lost"]] = [[1_234_567, 89_012], [45, 0], [300, 7]]
    zeros = ["gaps", "out_of_order", "doubled", "jumps"]
    rows = rows.assign(drift_ppm_se=None, **dict.fromkeys(zeros, 0)).astype({"samples": int, "lost": int})
    rows.attrs |= {"name": "flight.mcap", "survey": SimpleNamespace(channels={}), "lags": []}
    recordings.channels(rows, screen)
    return [*rows.samples, *rows.lost, *rows.rate, *(1e3 * rows.delay_median), *(1e3 * rows.delay_most)]


def contents_table(screen):
    rows = []
    for field in ("pose.position.x", "pose.orientation.w"):
        numbers = {"rate": 99.99, "least": sizes(1)[0], "most": sizes(1)[0], "first": 1.7e9, "last": 1.7e9 + 12.345}
        rows.append(
            {"topic": "/camera/pose", "frame": "", "kind": "PoseStamped", "field": field, "rows": 123_456} | numbers
        )
        rows[-1] |= {"constant": False, "repeats": 12, "missing": 3}
    recordings.print_contents("flight.mcap", rows, [], screen)
    return [row[name] for row in rows for name in ("rate", "least", "most")] + [123_453]


def replay_table(screen):
    tests = ["nis", "nis_low", "nis_high", "ljung_box_p", "log_likelihood", "log_likelihood_held_out"]
    rows = pd.DataFrame(RNG.random((4, len(tests))) + 0.1, columns=tests)
    rows = rows.assign(observer=OBSERVERS, samples=123_456, verdict="pessimistic", skipped=12)
    channels = pd.concat([rows.assign(channel=name) for name in ("imu/angular_velocity", "gps")])
    metrics = pd.DataFrame(list(product(OBSERVERS, "abcdef")), columns=["observer", "signal"])
    metrics = metrics.assign(metric="steady_rmse", unit="rad/s", value=sizes(len(metrics)))
    distances = metrics.rename(columns={"value": "rms"}).assign(rms=sizes(len(metrics)))
    about = {"log": "flight.mcap", "largest_rounding": 1e-3, "ticks": 12_344, "dt": 0.001, "steady_start": 12.5}
    recordings.print_replay(recordings_result(rows, channels, metrics, distances, about), "replayed", screen)
    return [*rows[tests].to_numpy().ravel(), *metrics.value, *distances.rms, 123_456]


def recordings_result(rows, channels, metrics, distances, about):
    return SimpleNamespace(innovations=rows, channels=channels, metrics=metrics, distances=distances, summary=about)


def trade_off_table(screen):
    table = pd.DataFrame(sizes(4, 5), columns=["decay", "rate", "margin", "noise_gain", "certified_rms"])
    table = table.assign(solver="CLARABEL", certified=True, fallback="", refused="")
    gains.trade_off("pccebo of cart/white", table, screen)
    return table[["decay", "rate", "margin", "noise_gain", "certified_rms"]].to_numpy().ravel()


def tuning_table(screen):
    numbers = {"start": 123.456, "tuned": 98.7654, "difference": -24.691}
    judged = [SimpleNamespace(seeds=s, what=w, start_se=0.5, tuned_se=0.4, difference_se=0.1, diverged=(3, 0), **numbers)
              for s, w in (("2000:2064", "training"), ("100000:100256", "validation"))]  # fmt: skip
    aim = SimpleNamespace(metric="steady_rmse", base="steady_rmse", name="angular_velocity")
    found = SimpleNamespace(
        objective=aim, judgements=judged, exact=False, certified=None, points=[1] * 40, method="CMA-ES"
    )
    found.best, found.start, found.kept_start = {"q": 0.123456789}, {"q": [1.5, 2.5]}, ""
    gains.print_tuning(found, "kf-shifted-innovation", None, screen)
    return [*numbers.values(), 0.123457]


def fair_table(screen):
    rows = pd.DataFrame(list(product(OBSERVERS, ["published", "designed", "tuned"])), columns=["observer", "tuning"])
    for name in ("held_out", "training", "gap"):
        rows[name] = sizes(len(rows))
        rows[f"{name}_se"] = rows[name] / 100
    rows = rows.assign(rms_efficiency=0.9876, cell=0, certified=True, diverged=1, label="", note="")
    rows = rows.assign(scenario="cart/white", metric="steady_rmse", signal="position", unit="m")
    gains.fair(rows, screen)
    return rows.held_out


def findings_table(screen):
    reasons = [f"the largest difference is {v:.6g}, at tick 123456 of the run with seed 4294967290" for v in VALUES]
    gains.print_findings("mine.py:nudge", [Finding("perfect start", "fails", reason) for reason in reasons], screen)
    return [*VALUES, 4294967290]


def c_table(screen):
    about = SimpleNamespace(signals=[("angular_velocity", "rad/s"), ("position", "m")], oldest=3, dt=0.1, newer=0)
    about.observer, about.scenario = "kf", "lti"
    signals = zip(about.signals, VALUES[:2], strict=True)
    lines = {name: SimpleNamespace(most=1.25e-16, differs=1.5e-7, error=value) for (name, _), value in signals}
    recordings.export_table(SimpleNamespace(about=about), lines, lines, "the recording", screen)
    return [*VALUES[:2]]


TABLES = [status_table, comparison_table, claims_table, limits_table, frontier_table, channels_table, contents_table,
          replay_table, trade_off_table, tuning_table, fair_table, findings_table, c_table]  # fmt: skip


@pytest.mark.parametrize("terminal", [False, True], ids=["piped", "terminal"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("table", TABLES)
def test_every_number_of_a_table_is_printed_whole(table, width, terminal):
    screen = Recorder(width, terminal)
    numbers = table(screen)
    require_whole(screen)
    require_numbers(screen, numbers)


@pytest.fixture(scope="module")
def study():
    axes = {"noise_std": [0.1, 0.5], "delay": [0.2, 0.6]}
    seen = {"scenario": {"consistency": True, "random_initial_state": True}}
    return pcbench.run(
        "cart/white", observers=["kf", "kf-ignore-delay", "pccebo", "model-only"], seeds=5, axes=axes, options=seen
    )


@pytest.mark.ci
@pytest.mark.parametrize("terminal", [False, True], ids=["piped", "terminal"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("longest", [48, 2])
def test_every_number_of_results_is_printed_whole(study, width, terminal, longest, monkeypatch):
    """Also if wins are counted, and verdicts on consistency."""
    monkeypatch.setattr(results, "LONGEST", longest)
    screen = Recorder(width, terminal)
    results.closing(study, screen, "steady_rmse", [])
    require_whole(screen)
    rows = study.stats[study.stats.metric == "steady_rmse"]
    medians = rows.groupby(["signal", "observer"])["mean"].median()
    require_numbers(screen, rows["mean"] if longest == 48 else medians)
    if longest == 48:
        flat = " ".join(screen.text.split())
        for row in rows.to_dict("records"):
            assert all(part in flat for part in number_format.interval(row).split(" "))


cells = st.one_of(st.floats(-1e9, 1e9).map(lambda v: f"{v:.7g}"), st.from_regex(r"[a-z]{1,12}-[a-z]{1,20}", fullmatch=True),
                  st.floats(1e-9, 1e6).map(lambda v: f"{v:.5g} ± {v / 7:.2g}"))  # fmt: skip


@given(st.data(), st.integers(1, 5), st.integers(1, 9), st.sampled_from([40, *WIDTHS]))
def test_no_word_of_any_table_is_cut(data, rows, many, width):
    columns = [Column("observer", data.draw(st.lists(cells, min_size=rows, max_size=rows)), is_text=True)]
    for i in range(many):
        texts = data.draw(st.lists(cells, min_size=rows, max_size=rows))
        columns.append(
            Column(f"head {i}", texts, spare=data.draw(st.sampled_from([0, 0, 1, 2])), prose=data.draw(st.booleans()))
        )
    screen = Recorder(width, False)
    screen.fit("a title", columns)
    require_whole(screen)


@pytest.mark.parametrize("width", [60, 66, 80])
def test_word_of_prose_is_not_cut_where_room_is_scarce(width):
    """The words of a row need 67 columns; in a narrower terminal it is a block."""
    screen = Recorder(width, False)
    screen.fit(
        "a title", [Column("observer", ["n" * 30], is_text=True), Column("reason", ["at " + "w" * 34], prose=True)]
    )
    require_whole(screen)
    assert ("observer: n" in screen.text) == (width < 67)


def test_cut_number_is_found():
    """The measure itself: a table without its last digit does not pass."""
    screen = Recorder(80, False)
    screen.fit("a title", [Column("observer", ["kf"], is_text=True), Column("rmse", ["0.013245"])])
    require_whole(screen)
    require_numbers(screen, [0.013245])
    text = screen.file.getvalue().replace("0.013245", "0.01324")
    screen.file = io.StringIO()
    screen.file.write(text)
    with pytest.raises(AssertionError):
        require_whole(screen)
    with pytest.raises(AssertionError):
        require_numbers(screen, [math.pi])
