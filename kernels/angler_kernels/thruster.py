"""Table look-ups on a uniform PWM grid and the rotor's exact dynamics, for one thruster."""

import jax
import jax.numpy as jnp

from angler_kernels.table import count_below, take_row


def lookup(
    table: jax.Array, pwm: jax.Array, first: jax.Array | float, step: jax.Array | float
) -> jax.Array:
    """Interpolate ``table`` [n] linearly at ``pwm`` [], held at both ends; result [].

    Args:
        table: [n] values at ``first + step * i``.
        pwm: [] us.
        first: [] PWM of the first entry, us.
        step: [] us between entries.
    """
    x = jnp.clip((pwm - first) / step, 0.0, table.shape[0] - 1.0)
    i = jnp.clip(jnp.floor(x).astype(jnp.int32), 0, table.shape[0] - 2)
    fraction = x - i
    return take_row(table, i) * (1.0 - fraction) + take_row(table, i + 1) * fraction


def inverse_lookup(
    table: jax.Array, value: jax.Array, first: jax.Array | float, step: jax.Array | float
) -> jax.Array:
    """Return the PWM [] at which a non-decreasing ``table`` [n] takes ``value`` [], clipped. ends.

    Where the table is flat (the dead band) the lower end of the flat stretch is returned;
    ``first`` [] and ``step`` [] as in `lookup`.
    """
    n = table.shape[0]
    clipped = jnp.clip(value, table[0], table[-1])
    i = jnp.clip(count_below(table, clipped), 1, n - 1)
    left = take_row(table, i - 1)
    rise = take_row(table, i) - left
    return first + step * (i - 1 + (clipped - left) / jnp.where(rise > 0, rise, 1.0))


def rotor_lag(
    thrust: jax.Array, command: jax.Array, tau: jax.Array, dt: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """Advance the lag tau f' = command - f by an exact step with a command held over it.

    Args:
        thrust: [...] N at the beginning of the step.
        command: [...] N.
        tau: time constant, s, > 0.
        dt: s.

    Returns:
        Thrust at the end of the step, and its mean over the step: dt times the mean is the exact
        impulse.
    """
    decay = jnp.exp(-dt / tau)
    gap = thrust - command
    return command + gap * decay, command + gap * ((1.0 - decay) * (tau / dt))


def rotor_filter(
    states: jax.Array,
    command: jax.Array,
    settled: jax.Array,
    transition: jax.Array,
    mean: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Advance a linear filter of order k by one step with a command held over it.

    The distance of the states from their rest values decays by itself: g = x - settled u, x(t+dt) =
    settled u + transition g, and the mean thrust is u + mean . g.

    Args:
        states: [k, ...] N; the first row is the thrust.
        command: [...] N.
        settled: [k] states at which the filter rests for a command of 1 N; the first is 1.
        transition: [k, k] exp(A dt).
        mean: [k] first row of the mean of exp(A t) over the step.

    Returns:
        States at the end of the step, and the mean thrust over it: dt times it is the impulse.
    """
    lead = (..., *(None,) * command.ndim)
    settled_states = settled[lead] * command
    gap = states - settled_states
    after = settled_states + jnp.sum(transition[lead] * gap, axis=1)
    return after, command + jnp.sum(mean[lead] * gap, axis=0)
