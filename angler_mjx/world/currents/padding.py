"""Currents in arrays of a few sizes: worlds with more vortices or knots have the same programs.

Padding changes no flow: vortices without circulation, and knots that repeat the last one.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_mjx.world.currents.fields import (
    Component,
    Current,
    CurrentSampler,
    GaussMarkov,
    Vortices,
)
from angler_mjx.world.currents.tables import GaussMarkovSampler, VorticesSampler

VORTEX_STEP, KNOT_STEP = 4, 32
"""Numbers of vortices and of knots are rounded up to multiples of these."""


def pad_samplers(samplers: Sequence[CurrentSampler]) -> tuple[CurrentSampler, ...]:
    """Return samplers of padded components; those that are sampled are the same."""
    return tuple(
        replace(sampler, capacity=_round_up(sampler.capacity, step))
        if isinstance(sampler, VorticesSampler | GaussMarkovSampler)
        and (step := VORTEX_STEP if isinstance(sampler, VorticesSampler) else KNOT_STEP)
        else sampler
        for sampler in samplers
    )


def component_sizes(samplers: Sequence[CurrentSampler]) -> tuple[int | None, ...]:
    """Return the vortices or knots of each component; None for kinds without padding."""
    return tuple(
        sampler.capacity if isinstance(sampler, VorticesSampler | GaussMarkovSampler) else None
        for sampler in samplers
    )


def pad_current(current: Current) -> Current:
    """Return padded currents, as `pad_samplers` sample them; any axes lead, the same in all."""
    return tuple(_pad_component(component) for component in current)


def cut_current(current: Current, sizes: Sequence[int | None]) -> Current:
    """Return currents without their padding.

    Args:
        current: of `pad_current`, or sampled by `pad_samplers`.
        sizes: of `component_sizes`.
    """
    return tuple(
        component if size is None else _cut_component(component, size)
        for component, size in zip(current, sizes, strict=True)
    )


def _pad_component(component: Component) -> Component:
    if isinstance(component, Vortices):
        count = component.core_m.shape[-1]
        extra = _round_up(count, VORTEX_STEP) - count
        return Vortices(
            centre_m=_append(component.centre_m, extra, axis=-2, value=0.0),
            circulation_m2ps=_append(component.circulation_m2ps, extra, axis=-1, value=0.0),
            core_m=_append(component.core_m, extra, axis=-1, value=1.0),
        )
    if isinstance(component, GaussMarkov):
        knots = component.knots_mps
        extra = _round_up(knots.shape[-2], KNOT_STEP) - knots.shape[-2]
        last = jnp.repeat(knots[..., -1:, :], extra, axis=-2)
        return replace(component, knots_mps=jnp.concatenate([knots, last], axis=-2))
    return component


def _cut_component(component: Component, size: int) -> Component:
    if isinstance(component, Vortices):
        return Vortices(
            centre_m=component.centre_m[..., :size, :],
            circulation_m2ps=component.circulation_m2ps[..., :size],
            core_m=component.core_m[..., :size],
        )
    if isinstance(component, GaussMarkov):
        return replace(component, knots_mps=component.knots_mps[..., :size, :])
    return component


def _append(values: jax.Array, extra: int, *, axis: int, value: float) -> jax.Array:
    """Return values with ``extra`` more of one value at the end of an axis."""
    widths = [(0, 0)] * values.ndim
    widths[axis] = (0, extra)
    return jnp.pad(values, widths, constant_values=value)


def _round_up(count: int, step: int) -> int:
    return -(-count // step) * step
