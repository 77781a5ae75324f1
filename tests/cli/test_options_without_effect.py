"""An option that has no effect with another, or without one, is refused in one sentence before any work."""

import pytest

from pcbench.cli.commands import app
from pcbench.errors import UserError

SEEDS = "expected exact values without seeds, or simulated runs"
CASES = [
    ("run cart/white --exact --seeds 8", "--seeds: got it with --exact", SEEDS),
    ("run cart/white --exact --first-seed 0", "--first-seed: got it with --exact", SEEDS),
    ("run cart/white --exact --until-se rmse=0.1", "--until-se: got it with --exact", SEEDS),
    ("run cart/white --exact --max-seeds 8", "--max-seeds: got it with --exact", SEEDS),
    ("run cart/white --exact --block 8", "--block: got it with --exact", SEEDS),
    ("run cart/white --set method=exact --seeds 8", '--seeds: got it with a study of method "exact"', SEEDS),
    ("run cart/white --exact --metric peak", "--metric: got peak, which has no exact value", "simulate runs"),
    ("run cart/white --exact --metric settling_time", "--metric: got settling_time, which has no exact", "tail_mse"),
    ("run cart/white --exact --metric tail_peak", "--metric: got tail_peak, which has no exact value", "tail_mse"),
    ("run cart/white --quiet --costs", "--costs: got it with --quiet", "where tables are printed"),
    ("run cart/white --json --timings", "--timings: got it with --json", "where tables are printed"),
    ("verify ds --figure q.svg", "--figure: got it without --exact", "expected both"),
    ("verify ds --exact --sample 0", "--sample: got it with --exact", "leave one out"),
    ("verify ds --exact --all", "--all: got it with --exact", "leave one out"),
    ("verify ds --exact --seed 0", "--seed: got it with --exact", "leave one out"),
    ("verify ds --all --sample 2", "--sample: got it with --all", "every block, or some"),
    ("verify ds --all --seed 2", "--seed: got it with --all", "every block, or some"),
    ("show cart/white --costs --toml", "--toml: got it with --costs", "leave one out"),
    ("report ds --kinds svg", "--kinds: got it without --figures", "expected both"),
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
