"""Random signals of thrusters, as a policy: every robot of every world its own habit."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.sim.policy import Policy

LOW_US, NEUTRAL_US, HIGH_US = 1100.0, 1500.0, 1900.0
HABITS = 6
"""One draw held to the end, full thrust of random signs, full thrust held, full thrust changed now
and then, anything at every step, and about the dead band."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Signals(Policy):
    """Gives signals without looking at anything."""

    change: jax.Array | float = 0.03
    """Chance of other signals at a step, for the habit that changes now and then."""

    def reset(self, known, key):
        """The habit [R] and first signals [R, n_thruster]."""
        robots, thrusters = known.goal_m.shape[0], known.params.vehicle.B.shape[-1]
        of_habit, of_signals = jax.random.split(key)
        habit = jax.random.randint(of_habit, (robots,), 0, HABITS)
        return habit, self._drawn(habit, of_signals, (robots, thrusters))

    def act(self, carry, known, key, step):
        """New signals for those whose habit is to change."""
        habit, held = carry
        of_signals, of_change = jax.random.split(key)
        drawn = self._drawn(habit, of_signals, held.shape)
        now = jax.random.uniform(of_change, habit.shape) < self.change
        changes = jnp.where(habit == 3, now, habit >= 4)
        held = jnp.where(changes[:, None], drawn, held)
        return (habit, held), ThrusterPwm(pwm_us=held)

    def _drawn(self, habit, key, shape):
        of_sign, of_size = jax.random.split(key)
        full = jnp.where(jax.random.bernoulli(of_sign, 0.5, shape), LOW_US, HIGH_US)
        share = jax.random.uniform(of_size, shape)
        anything = LOW_US + (HIGH_US - LOW_US) * share
        dead = NEUTRAL_US + 80.0 * (share - 0.5)
        which = habit[:, None]
        return jnp.where((which == 0) | (which == 4), anything, jnp.where(which == 5, dead, full))
