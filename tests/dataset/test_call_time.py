"""How long a call takes, estimated from its first ticks."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcbench.dataset import timing
from pcbench.engine import runner


def job(ticks):
    windows = np.array([[0, ticks // 4], [ticks // 4, ticks - 1], [ticks - 1, ticks]])
    problem = SimpleNamespace(windows=windows, _replace=lambda windows: SimpleNamespace(windows=windows))
    return SimpleNamespace(problem=problem, _replace=lambda problem: SimpleNamespace(problem=problem))


@pytest.fixture
def clock(monkeypatch):
    """A clock that moves by what each tick costs: `costs` (before the first arrival, after it, the tick of that)."""
    now, ends, costs, start = [0.0], [], [0.01, 0.5, 40], [0.02, 0.02]

    def serial(made, jobs):
        (one,) = jobs
        windows = one.problem.windows
        assert (windows[:, 0] <= windows[:, 1]).all()
        assert (windows[1:, 0] == windows[:-1, 1]).all(), "one window begins where another ends"
        end = int(windows[-1, 1])
        ends.append(end - 1)
        now[0] += start[min(len(ends) - 1, 1)] + costs[0] * min(end, costs[2]) + costs[1] * max(end - costs[2], 0)
        yield None

    monkeypatch.setattr(runner, "serial", serial)
    monkeypatch.setattr(timing, "perf_counter", lambda: now[0])
    return SimpleNamespace(ends=ends, costs=costs, start=start)


STEPS = SimpleNamespace(layout=SimpleNamespace(by_definition=False))


def test_estimate_is_of_ticks_after_the_first_arrival(clock):
    found = timing.seconds(STEPS, job(6000))
    assert clock.ends == [4, 8, 16, 32, 64]
    assert 0.3 * 3000 < found <= 3000


def test_constant_cost_of_a_tick_is_found_exactly(clock):
    clock.costs[:] = 0.1, 0.1, 0
    assert timing.seconds(STEPS, job(5000)) == pytest.approx(500, rel=1e-3)


def test_slow_start_of_the_program_is_not_a_cost_of_its_ticks(clock):
    clock.start[0] = 3.0
    clock.costs[:] = 0.001, 0.001, 0
    assert timing.seconds(STEPS, job(30_000)) == pytest.approx(30, rel=0.01)


def test_call_that_is_clearly_short_is_timed_once(clock):
    clock.costs[:] = 1e-5, 1e-5, 0
    assert timing.seconds(STEPS, job(200)) < 61  # 0.02 s of it are the start of a call
    assert len(clock.ends) <= 2


def test_call_is_estimated_from_a_sixteenth_of_its_ticks_at_most(clock):
    clock.costs[:] = 0.001, 0.001, 0
    timing.seconds(STEPS, job(2000))
    assert max(clock.ends) <= 2000 / 16


def test_call_of_the_definition_is_not_timed(clock):
    assert timing.seconds(SimpleNamespace(layout=SimpleNamespace(by_definition=True)), job(6000)) == 0
    assert not clock.ends
