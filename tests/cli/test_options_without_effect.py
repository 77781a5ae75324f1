"""An option that has no effect with another, or without one, is refused in one sentence before any work."""

import pytest

from pcbench.cli.commands import app
from pcbench.errors import UserError

SEEDS = "exact values need no runs; leave one of them out."
CASES = [
    ("run cart/white --evaluation exact --seeds 8", "--seeds has no effect with --evaluation exact; ", SEEDS),
    ("run cart/white --evaluation exact --first-seed 0", "--first-seed has no effect with --evaluation exact; ", SEEDS),
    (
        "run cart/white --evaluation exact --until-se rmse=0.1",
        "--until-se has no effect with --evaluation exact; ",
        SEEDS,
    ),
    ("run cart/white --evaluation exact --max-seeds 8", "--max-seeds has no effect with --evaluation exact; ", SEEDS),
    ("run cart/white --evaluation exact --block-size 8", "--block-size has no effect with --evaluation exact; ", SEEDS),
    (
        "run cart/white --set evaluation=exact --seeds 8",
        '--seeds has no effect in a study with evaluation = "exact"; ',
        SEEDS,
    ),
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
    ("run cart/white --quiet --operations", "--operations has no effect with --quiet; ", "no table is printed"),
    ("run cart/white --json --timings", "--timings has no effect with --json; ", "no table is printed"),
    ("verify ds --figure q.svg", "--figure has no effect without --exact; ", "or leave it out."),
    ("verify ds --exact --sample 0", "--sample has no effect with --exact; ", "leave one of them out."),
    ("verify ds --exact --all", "--all has no effect with --exact; ", "leave one of them out."),
    ("verify ds --exact --seed 0", "--seed has no effect with --exact; ", "leave one of them out."),
    ("verify ds --all --sample 2", "--sample has no effect with --all; ", "leave one of them out."),
    ("verify ds --all --seed 2", "--seed has no effect with --all; ", "leave one of them out."),
    ("show cart/white --operations --toml", "--toml has no effect with --operations; ", "leave one of them out."),
    ("report ds --formats svg", "--formats has no effect without --figures; ", "or leave it out."),
    ("report ds --width 3", "--width has no effect without --figures; ", "or leave it out."),
    ("report ds --size 9", "--size has no effect without --figures; ", "or leave it out."),
    ("report ds --font Arial", "--font has no effect without --figures; ", "or leave it out."),
]


@pytest.mark.parametrize(("words", "begins", "holds"), CASES, ids=[words for words, *_ in CASES])
def test_an_option_without_effect_is_refused(words, begins, holds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError) as error:
        app(words.split(), standalone_mode=False)
    assert str(error.value).startswith(begins)
    assert holds in str(error.value)
    assert not list(tmp_path.iterdir())
