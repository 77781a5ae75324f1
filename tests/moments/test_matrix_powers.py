"""Some ticks in a row: powers of a tick's matrix put covariances and vectors where one tick after the other does."""

import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.moments import propagate
from pcbench.moments.nees import WRITTEN_OUT
from pcbench.runtime import config

CELLS = 3


# A numbers that noise reaches, V that are seen, w of noise a tick, ticks, numbers on the network, joint covariances, until
CASES = [
    (2, 1, 0, 3, 0, False, 2),
    (3, 2, 1, 4, 2, True, 1),
    (1, 2, 2, 1, 1, False, 1),
    (WRITTEN_OUT + 1, 2, 1, 3, 2, False, 3),
]


@pytest.mark.ci
@pytest.mark.parametrize(("A", "V", "w", "ticks", "more", "joint", "until"), CASES)
def test_powers_of_a_tick_are_ticks_one_by_one(A, V, w, ticks, more, joint, until):
    draw = np.random.default_rng([A, V, w, ticks, more]).normal
    M, root, z = (
        draw(size=(A + V, A + w, CELLS)),
        draw(size=(A + more, A + more, CELLS)),
        draw(size=(2, A + more, CELLS)),
    )
    P0 = np.einsum("ijc,kjc->ikc", root, root)
    with config.float64():
        M_, P_, z_ = map(jnp.asarray, (M, P0, z))
        by = propagate.powers(M_, A, ticks, joint)
        seen, after = propagate.covariances(by, P_, joint), propagate.after(by, jnp.asarray(until), P_)
        shown, later = propagate.seen_of(by, z_), propagate.later(by, jnp.asarray(until), z_)
    for c in range(CELLS):
        S, N, P, at = M[:, :A, c], M[:, A:, c], P0[..., c], z[..., c]
        for j in range(ticks):
            if j == until:
                np.testing.assert_allclose(after[..., c], P, rtol=1e-10, atol=1e-10 * np.abs(P).max())
                np.testing.assert_allclose(later[..., c], at, rtol=1e-10, atol=1e-10 * np.abs(at).max())
            whole = S[A:] @ P[:A, :A] @ S[A:].T + N[A:] @ N[A:].T
            expected = whole if joint else np.diag(whole)[:, None]
            np.testing.assert_allclose(seen[j, ..., c], expected, rtol=1e-10, atol=1e-10 * np.abs(whole).max())
            np.testing.assert_allclose(shown[j, ..., c], at[:, :A] @ S[A:].T, rtol=1e-10, atol=1e-10 * np.abs(at).max())
            F, Q = np.eye(A + more), np.zeros((A + more, A + more))
            F[:A, :A], Q[:A, :A] = S[:A], N[:A] @ N[:A].T
            P, at = F @ P @ F.T + Q, at @ F.T
        if until == ticks:
            np.testing.assert_allclose(after[..., c], P, rtol=1e-10, atol=1e-10 * np.abs(P).max())
