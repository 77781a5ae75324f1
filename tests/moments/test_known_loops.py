"""Loops whose moments others computed, to all the digits that they print: JitterTime's examples and Jitterbug's."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from moving import Case, Loop, integral, moments

pytestmark = pytest.mark.usefixtures("in_a_hurry")

# minimum-variance control of an integrator that starts after three samples. Source: JitterTime.jl, test/example_1_test.jl

K = (3 + np.sqrt(3)) / (2 + np.sqrt(3))
FINE = 4  # ticks a period
INTEGRATOR = Loop(
    *(np.array([[a]]) for a in (0.0, 1.0, 1.0)), [0.0], 1 / FINE, 60 * FINE,
    jump=lambda gains, memory, now, arrival: jnp.where(arrival.index >= 3, arrival.value, memory),
    memory=1,
    law=lambda p, tick, memory, kept: jnp.where(tick % FINE == 0, -K * memory, kept),
    kept=1,
)  # fmt: skip


def test_minimum_variance_control_of_an_integrator():
    (P,) = moments(INTEGRATOR, [Case([FINE], ())])
    x = P[:, 0, 0]
    assert integral(x[: 6 * FINE + 1], 1 / FINE, FINE) == pytest.approx(7.420841162336914, rel=1e-13)
    assert x[6 * FINE] == pytest.approx(1.0780618346944955, rel=1e-13)
    late = P[50 * FINE]
    assert late[0, 0] == pytest.approx(1.07735027, abs=5e-9)
    assert K * late[0, 1] == pytest.approx(-1.3660254, abs=5e-8)  # Pxu = -K Pxy, and an error of a memory is -y
    assert K * K * late[1, 1] == pytest.approx(1.73205081, abs=5e-9)
    assert integral(x[50 * FINE : 51 * FINE + 1], 1 / FINE, FINE) == pytest.approx((3 + np.sqrt(3)) / 6, rel=1e-12)


# the asynchronous Kalman filter of an inverted pendulum. Source: JitterTime.jl, test/example_2_test.jl

AO1, BO1 = np.array([[0.5309, 0.079], [-0.8673, 0.8597]]), np.array([[0.0059, 0.4750], [0.1392, 1.0065]])  # of u, y1
AO2, BO2 = np.array([[1.0, -0.3906], [0.0, 0.0163]]), np.array([0.3906, 0.9837])  # of y2
FEEDBACK = np.array([3.633, 2.7434])
H, EVERY = 0.00625, 24


def two_gains(gains, memory, now, arrival):
    """y2 corrects, y1 predicts over its own period and corrects; samples of t = 0 are not in it."""
    used = arrival.mask & (arrival.index > 0)
    second = jnp.where(used[1], AO2 @ memory + BO2 * arrival.value[1], memory)
    first = AO1 @ second + BO1[:, 0] * now.u[0] + BO1[:, 1] * arrival.value[0]
    return jnp.where(used[0], first, second)


@pytest.mark.nightly
def test_an_asynchronous_filter_in_the_loop():
    pendulum = Loop(
        np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2), [0.1**0.5, 0.1], H, 1920,
        jump=two_gains, memory=2,
        law=lambda p, tick, memory, kept: jnp.where(tick % EVERY == 0, -FEEDBACK @ memory, kept), kept=1,
    )  # fmt: skip
    (P,) = moments(pendulum, [Case([EVERY, 80], ())])
    u = np.einsum("i,tij,j->t", FEEDBACK, P[:, 2:, 2:], FEEDBACK)
    held = u[np.arange(1920) // EVERY * EVERY]
    cost = integral(P[:, 0, 0] + 0.1 * P[:, 1, 1], H, 4) + 0.1 * H * held.sum()
    assert cost == pytest.approx(12.574852494566, rel=1e-12)
    assert P[-1, 0, 0] == pytest.approx(0.334482211089, abs=1e-12)
    assert P[-1, 1, 1] == pytest.approx(0.736398452637, abs=1e-12)
    assert u[-1] == pytest.approx(11.222643465877, abs=1e-11)


# ball and beam under a cascade of a PID and a P controller. Source: Jitterbug, examples/multirate.m

SAME = 4  # ticks of half a period
ZEROS, POLES, GAIN = np.roots([1.1, 1.01, 0.1]), np.array([0.0, -10.0]), 2.2
J = [3.3955, 1.9329, 1.9910]


def match_poles(h):
    """Numerator and denominator in z: zeros and poles go to e^{h s}, the gain is that at s = 0.1 / h."""
    zeros, poles, s = np.exp(h * ZEROS), np.exp(h * POLES), 0.1 / h
    known = GAIN * np.prod(s - ZEROS) / np.prod(s - POLES)
    return known * np.prod(np.exp(0.1) - poles) / np.prod(np.exp(0.1) - zeros) * np.poly(zeros), np.poly(poles)


def cascade(params, tick, memory, kept):
    """kept: two states of the PID, its output, the input."""
    b, a, outer, inner = params
    (phi, x), (s1, s2, ref, u) = memory, kept
    out = b[0] * x + s1
    pid = jnp.stack([b[1] * x - a[1] * out + s2, b[2] * x - a[2] * out, out])
    pid = jnp.where(tick % outer == 0, pid, jnp.stack([s1, s2, ref]))
    return jnp.append(pid, jnp.where(tick % inner == 0, 4.0 * (pid[2] - phi), u))


@pytest.mark.nightly
def test_ball_and_beam_at_three_rates():
    """The slowest mode decays at 0.1 1/s: after 160 s nothing is left of the start in the digits printed."""
    A = np.array([[0.0, 0.0, 0.0], [-9.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    ball = Loop(
        A, np.array([[4.4], [0.0], [0.0]]), np.array([[1.0, 0, 0], [0, 0, 1]]), [0.0, 0.0], 0.05 / SAME, 3200 * SAME,
        jump=lambda gains, memory, now, arrival: jnp.where(arrival.mask, arrival.value, memory), memory=2,
        law=cascade, kept=4,
    )  # fmt: skip
    rates = [(2 * SAME, 2 * SAME), (SAME, SAME), (2 * SAME, SAME)]
    cases = [
        Case([inner, outer], (*match_poles(outer * ball.tick), np.asarray(outer), np.asarray(inner)))
        for outer, inner in rates
    ]
    for P, known in zip(moments(ball, cases), J, strict=True):
        last = P[-2 * SAME - 1 :]
        found = integral(last[:, 0, 0] + last[:, 2, 2], ball.tick, SAME) / (2 * SAME * ball.tick)
        assert found == pytest.approx(known, abs=5e-5)


# a scalar plant whose samples arrive with a probability, under the best constant gain. Source: the modified Riccati equation

VARIANCE = {0.4: 39.512342, 0.5: 11.955894, 0.7: 5.40075, 0.9: 3.66115}
A, R = 1.25, 2.5


@pytest.mark.ci
def test_the_best_constant_gain_where_samples_are_lost():
    """The command takes off all that is known, so that the state is the error of the prediction, and stays small."""
    b = ((A * A - 1) / (2 * np.log(A))) ** -0.5  # so that a tick adds noise of variance 1
    unit = b * (A - 1) / np.log(A)  # what an input of 1 adds over a tick
    scalar = Loop(
        np.array([[np.log(A)]]), np.array([[b]]), np.array([[1.0]]), [R**0.5], 1.0, 600,
        jump=lambda gains, memory, now, arrival: jnp.where(arrival.mask, gains * arrival.value, memory), memory=1,
        law=lambda p, tick, memory, kept: -A * memory / p, kept=1,
        flow=lambda gains, memory, now: jnp.zeros(1),
    )  # fmt: skip
    cases = [Case([1], np.asarray(unit), l, np.array([p / (p + R)])) for l, p in VARIANCE.items()]
    for P, known in zip(moments(scalar, cases), VARIANCE.values(), strict=True):
        assert P[-1, 0, 0] == pytest.approx(known, rel=2e-7)


@pytest.mark.ci
def test_losses_add_the_variance_of_what_they_do_to_the_mean():
    """From x(0) = 2, where a sample moves the mean, against every pattern of losses one by one."""
    a, gain, back, every, N, chance = 0.3, 0.8, 0.5, 3, 12, 0.6
    lossy = Loop(
        np.array([[a]]), np.array([[1.0]]), np.array([[1.0]]), [0.4], 1.0, N,
        jump=lambda gains, memory, now, arrival: jnp.where(arrival.mask, gain * arrival.value, memory), memory=1,
        law=lambda p, tick, memory, kept: -back * memory, kept=1, x0=2.0,
    )  # fmt: skip
    (P,) = moments(lossy, [Case([every], (), chance)])
    step = np.array([[np.exp(a), -back * (np.exp(a) - 1) / a], [0.0, 1.0]])
    added, take = np.diag([(np.exp(2 * a) - 1) / (2 * a), 0.0]), np.array([[1.0, 0.0], [gain, 0.0]])
    first, second = np.zeros((N + 1, 2)), np.zeros((N + 1, 2, 2))
    for arrive in itertools.product([True, False], repeat=N // every + 1):
        m, S, weight = np.array([2.0, 0.0]), np.zeros((2, 2)), np.prod(np.where(arrive, chance, 1 - chance))
        for k in range(N + 1):
            if k % every == 0 and arrive[k // every]:
                m, S = take @ m, take @ S @ take.T + np.diag([0.0, (gain * 0.4) ** 2])
            first[k], second[k] = first[k] + weight * m, second[k] + weight * (S + np.outer(m, m))
            m, S = step @ m, step @ S @ step.T + added
    known = second - np.einsum("ti,tj->tij", first, first)
    np.testing.assert_allclose(P[:, 0, 0], known[:, 0, 0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(P[:, 0, 1], -known[:, 0, 1], rtol=1e-10, atol=1e-12)  # an error of a memory is -m
    np.testing.assert_allclose(P[:, 1, 1], known[:, 1, 1], rtol=1e-10, atol=1e-12)
