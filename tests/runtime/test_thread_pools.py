"""What is queued is done where all goes well, and not begun once something went wrong."""

from concurrent.futures import CancelledError
from contextlib import suppress
from threading import Event, Thread, Timer
from time import perf_counter, sleep

import pytest

from pcbench.dataset import executors
from pcbench.runtime.thread_pools import pool


def test_what_is_asked_for_is_done():
    with pool(2) as threads:
        assert [f.result() for f in [threads.submit(abs, -i) for i in range(5)]] == list(range(5))


@pytest.mark.parametrize(
    ("error", "always_wait", "waits"),
    [(ValueError, False, True), (KeyboardInterrupt, False, False), (KeyboardInterrupt, True, True)],
)
def test_after_an_error_nothing_more_is_begun(error, always_wait, waits):
    """After Ctrl-C what has begun is not waited for, unless it writes."""
    begun, ended, go = [], [], Event()

    def work(i):
        begun.append(i)
        go.wait(10)
        ended.append(i)

    def stopped():
        with pool(1, always_wait) as threads:
            for i in range(5):
                threads.submit(work, i)
            while not begun:
                sleep(0.01)
            if waits:
                Timer(0.2, go.set).start()  # what has begun ends by itself, once the others are taken back
            raise error

    with pytest.raises(error):
        stopped()
    assert ended == ([0] if waits else [])
    go.set()
    assert begun == [0]


def test_a_generator_that_is_closed_waits_for_nothing():
    go = Event()

    def each():
        with pool(1) as threads:
            threads.submit(go.wait, 10)
            yield 1

    steps = each()
    next(steps)
    start = perf_counter()
    steps.close()
    assert perf_counter() - start < 5
    go.set()


def test_after_an_interrupt_a_study_waits_for_what_is_written_and_not_for_what_is_computed():
    events, writes, compute, write = [], Event(), Event(), Event()

    def work(task, hold):
        with hold():
            events.append(f"computing {task}")
            if task == "slow":
                compute.wait(10)
        events.append(f"writing {task}")
        writes.set()
        write.wait(10)
        events.append(f"written {task}")

    def drawn(running):
        with suppress(CancelledError):
            list(running)

    def stopped():
        with executors.local_executor(2) as execute:
            Thread(target=drawn, args=[execute(work, ["slow", "quick"])]).start()
            assert writes.wait(10)
            Timer(0.2, write.set).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert sorted(events) == ["computing quick", "computing slow", "writing quick", "written quick"]
    compute.set()
    sleep(0.1)
    assert "writing slow" not in events
