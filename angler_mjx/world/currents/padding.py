"""Currents in arrays of a few sizes: worlds with more vortices or knots have the same programs.

Sampling programs take padded vortices and knots, programs of flights padded knots only: vortices
without circulation change no flow, but with another number of them XLA rounds otherwise.
"""

from collections.abc import Sequence
from dataclasses import replace

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
    """Return samplers of padded components; vortices and knots that exist are the same."""
    return tuple(_pad_sampler(sampler) for sampler in samplers)


def component_sizes(samplers: Sequence[CurrentSampler]) -> tuple[int | None, ...]:
    """Return the vortices or knots of each component; None for kinds without padding."""
    return tuple(
        sampler.capacity if isinstance(sampler, VorticesSampler | GaussMarkovSampler) else None
        for sampler in samplers
    )


def flight_sizes(samplers: Sequence[CurrentSampler]) -> tuple[int | None, ...]:
    """Return the sizes as of `component_sizes` that programs of flights take."""
    return tuple(
        size if size is None or isinstance(sampler, VorticesSampler) else _round_up(size, KNOT_STEP)
        for sampler, size in zip(samplers, component_sizes(samplers), strict=True)
    )


def pad_knots(current: Current) -> Current:
    """Return currents with padded knots, as programs of flights take them; any axes lead."""
    return tuple(
        _pad_markov(component) if isinstance(component, GaussMarkov) else component
        for component in current
    )


def cut_current(current: Current, sizes: Sequence[int | None]) -> Current:
    """Return currents with less padding or none.

    Args:
        current: of `pad_knots`, or sampled by `pad_samplers`.
        sizes: of `component_sizes` or `flight_sizes`.
    """
    return tuple(
        component if size is None else _cut_component(component, size)
        for component, size in zip(current, sizes, strict=True)
    )


def _pad_sampler(sampler: CurrentSampler) -> CurrentSampler:
    if isinstance(sampler, VorticesSampler):
        return replace(sampler, capacity=_round_up(sampler.capacity, VORTEX_STEP))
    if isinstance(sampler, GaussMarkovSampler):
        return replace(sampler, capacity=_round_up(sampler.capacity, KNOT_STEP))
    return sampler


def _pad_markov(component: GaussMarkov) -> GaussMarkov:
    """Repeat the last knot."""
    knots = component.knots_mps
    extra = _round_up(knots.shape[-2], KNOT_STEP) - knots.shape[-2]
    last = jnp.repeat(knots[..., -1:, :], extra, axis=-2)
    return replace(component, knots_mps=jnp.concatenate([knots, last], axis=-2))


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


def _round_up(count: int, step: int) -> int:
    return -(-count // step) * step
