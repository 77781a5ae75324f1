"""A processor that computes one sample at a time, the long way: which samples it uses, and when their estimates are usable.

Every tick of h seconds has v h multiplications. First the estimate is moved, `tick` multiplications; what is left goes to one
sample. Its multiplications are linear in its age and in the interval since the sample before it: `own` at the delay and the
period of the sensor, `older` at one period more of age, `rarer` at one period more of interval; fewer than `own` count like it.

The time w [ticks] that is set aside for each sample is tried from 0 on, until all of its work fits. Then the samples arrive one
after another, and one that finds the processor busy is lost.
"""

from fractions import Fraction
from math import ceil, floor
from typing import NamedTuple


class Work(NamedTuple):
    own: int
    older: int
    rarer: int
    tick: int


def ticks_needed(work, w, period, speed, h):
    """The nearest whole number of ticks that a sample takes of which w are set aside; None: it is never done."""
    left = Fraction(speed) * Fraction(h) - work.tick
    if left <= 0:
        return None, None
    used = max(1, ceil(Fraction(w, period)))
    more_age = Fraction(w, period) * max(work.older - work.own, 0)
    more_interval = (used - 1) * max(work.rarer - work.own, 0)
    exact = (work.own + more_age + more_interval) / left
    return floor(exact + Fraction(1, 2)), exact


def time_set_aside(work, delay, period, ticks, speed, h):
    """The least w [ticks]; None where no sample would be done within the run. And whether a count was close to half a tick."""
    close = False
    for w in range(ticks - delay + 1):
        need, exact = ticks_needed(work, w, period, speed, h)
        if need is None:
            return None, close
        close |= abs(exact - floor(exact) - Fraction(1, 2)) < Fraction(1, 10**9)
        if exact <= ticks and need <= w:
            return w, close
    return None, close


def used(w, delay, period, phase, ticks):
    """(number, tick at which it is taken, tick at which its estimate is usable) of every sample that is used."""
    if w is None:
        return []
    out, free = [], 0
    for number, taken in enumerate(range(phase, ticks + 1, period)):
        arrives = taken + delay
        if arrives >= free:
            free = arrives + w
            out.append((number, taken, free))
    return out
