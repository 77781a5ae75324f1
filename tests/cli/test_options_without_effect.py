"""An option that has no effect with another, or without one, is refused in one sentence before any work."""

import pytest

from pcbench.cli.commands import app
from pcbench.errors import UserError

SEEDS = "expected exact values without seeds, or simulated runs"
CASES = [
    ("run cart/white --evaluation exact --seeds 8", "--seeds: got it with --evaluation exact", SEEDS),
    ("run cart/white --evaluation exact --first-seed 0", "--first-seed: got it with --evaluation exact", SEEDS),
    ("run cart/white --evaluation exact --until-se rmse=0.1", "--until-se: got it with --evaluation exact", SEEDS),
    ("run cart/white --evaluation exact --max-seeds 8", "--max-seeds: got it with --evaluation exact", SEEDS),
    ("run cart/white --evaluation exact --block-size 8", "--block-size: got it with --evaluation exact", SEEDS),
    ("run cart/white --set evaluation=exact --seeds 8", '--seeds: got it with a study of evaluation "exact"', SEEDS),
    (
        "run cart/white --evaluation exact --metric max_abs_error",
        "--metric: got max_abs_error, which has no exact value",
        "simulate runs",
    ),
    (
        "run cart/white --evaluation exact --metric settling_time",
        "--metric: got settling_time, which has no exact",
        "steady_mse",
    ),
    (
        "run cart/white --evaluation exact --metric steady_max_abs_error",
        "--metric: got steady_max_abs_error, which has no exact value",
        "steady_mse",
    ),
    ("run cart/white --quiet --operations", "--operations: got it with --quiet", "where tables are printed"),
    ("run cart/white --json --timings", "--timings: got it with --json", "where tables are printed"),
    ("verify ds --figure q.svg", "--figure: got it without --exact", "expected both"),
    ("verify ds --exact --sample 0", "--sample: got it with --exact", "leave one out"),
    ("verify ds --exact --all", "--all: got it with --exact", "leave one out"),
    ("verify ds --exact --seed 0", "--seed: got it with --exact", "leave one out"),
    ("verify ds --all --sample 2", "--sample: got it with --all", "every block, or some"),
    ("verify ds --all --seed 2", "--seed: got it with --all", "every block, or some"),
    ("show cart/white --operations --toml", "--toml: got it with --operations", "leave one out"),
    ("report ds --formats svg", "--formats: got it without --figures", "expected both"),
    ("report ds --width 3", "--width: got it without --figures", "expected both"),
    ("report ds --size 9", "--size: got it without --figures", "expected both"),
    ("report ds --font Arial", "--font: got it without --figures", "expected both"),
]


@pytest.mark.parametrize(("words", "begins", "holds"), CASES, ids=[words for words, *_ in CASES])
def test_an_option_without_effect_is_refused(words, begins, holds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError) as error:
        app(words.split(), standalone_mode=False)
    assert str(error.value).startswith(begins)
    assert holds in str(error.value)
    assert not list(tmp_path.iterdir())
