"""Where a mode takes the place of those before it: conditional means and covariances of C modes, mixed (see `modes`)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from pcbench.moments.delay_modes import Mode
from pcbench.moments.nees import squared
from pcbench.moments.noise_state import Form, vectors


class Mix(NamedTuple):
    """From which of C modes, side by side, each takes over; s sources at most."""

    source: Any  # [s, C]
    weight: Any  # [s, C], 0 of one that is there for the room alone
    here: Any  # [N+1, C] whether it does at a tick


def mix_of(modes: list[Mode]) -> Mix:
    """Lay out modes side by side: those of one cell stand together, and the last may be there more than once."""
    many = max(len(mode.source) for mode in modes)
    source, weight = np.zeros((many, len(modes)), int), np.zeros((many, len(modes)))
    first = 0
    for at, mode in enumerate(modes):
        if mode.number == 0:
            first = at
        mine = [first + number for number in mode.source]
        source[:, at] = mine + mine[:1] * (many - len(mine))
        weight[: len(mine), at] = mode.weight
    return Mix(source, weight, np.stack([mode.merged for mode in modes], -1))


def merged(form: Form, mix: Mix, k: Array, m: Any) -> Any:
    """Return what moves after modes have taken over at tick k, where any does."""
    return lax.cond(jnp.any(mix.here[k]), lambda: _merged(form, mix, mix.here[k], m), lambda: m)


def _merged(form: Form, mix: Mix, here: Array, m: Any) -> Any:
    z, noisy = vectors(form, m.runs)[0], m.flight.shape[0] - 1  # with noise
    if form.flight:
        z = jnp.concatenate([z, m.flight[0].reshape(-1, z.shape[-1])])
    z = jnp.concatenate([z[None], m.apart[noisy:]])
    mean, P = _mean(mix, here, z), jnp.zeros_like(m.P)
    for source, weight in zip(mix.source, mix.weight, strict=True):
        apart = jnp.moveaxis(z[..., source] - mean, 0, 1)
        P = P + _on(weight, P) * (m.P[..., source] + squared(apart))
    leaves, tree = jax.tree.flatten(m.runs)
    unlike = [_unlike(mix, a) for a, moves in zip(leaves, form.moving, strict=True) if not moves]
    runs = [
        _mean(mix, here, a) if moves else jnp.where(_on(here, a), a[..., mix.source[0]], a)
        for a, moves in zip(leaves, form.moving, strict=True)
    ]
    return m._replace(
        runs=jax.tree.unflatten(tree, runs),
        flight=_mean(mix, here, m.flight),
        P=jnp.where(_on(here, P), P, m.P),
        apart=_mean(mix, here, m.apart),
        unlike=jnp.maximum(m.unlike, jnp.where(here, jnp.max(jnp.stack([jnp.zeros_like(m.unlike), *unlike]), 0), 0.0)),
    )


def _mean(mix: Mix, here: Array, a: Array) -> Array:
    """The mean [..., C] over what was before, where a mode takes over."""
    pairs = zip(mix.source, mix.weight, strict=True)
    return jnp.where(_on(here, a), sum(_on(weight, a) * a[..., source] for source, weight in pairs), a)


def _on(v: Array, a: Array) -> Array:
    """Numbers [C], one a mode, for products with [..., C]."""
    return v.reshape(*(1 for _ in a.shape[1:]), -1)


def _unlike(mix: Mix, a: Array) -> Array:
    """By how much [C] modes that give way to one differ in numbers [..., C] without noise, relative to the largest."""
    first, out = a[..., mix.source[0]], jnp.zeros(a.shape[-1])
    for source in mix.source[1:]:
        other = a[..., source]
        off = jnp.abs(other.astype(float) - first.astype(float))
        off = jnp.where(other == first, 0.0, jnp.where(jnp.isnan(off), jnp.inf, off))
        off, size = (jnp.max(x, tuple(range(a.ndim - 1)), initial=0.0) for x in (off, jnp.abs(first.astype(float))))
        out = jnp.maximum(out, off / jnp.maximum(size, 1e-300))
    return out
