"""A guard against what takes for ever: no test depends on how long anything else takes."""

import signal
from contextlib import contextmanager

SECONDS = 60  # of the processor: a study that is neither planned nor refused by then takes for ever,
ASLEEP = 600  # and so does one that takes so long by the clock


@contextmanager
def in_time():
    """Raise TimeoutError where the body takes more than SECONDS of the processor, or sleeps for ever."""

    def late(*_):
        raise TimeoutError(f"neither planned nor refused after {SECONDS} s")

    before = {number: signal.signal(number, late) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(ASLEEP)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        for number, handler in before.items():
            signal.signal(number, handler)
