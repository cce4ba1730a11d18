"""Policy that flies robots near their goals by their plans, and brings their end effectors there.

Far from its goal a robot follows its plan. Within `Reach.begin_m` of it, its controllers get the
goal as a target of the end effector instead: base and arm are placed by inverse kinematics.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.commands.whole_body import EndEffectorTarget
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.sim.policy import Policy, PolicyInput

END_FACTOR = 1.5
"""A robot that is farther from its goal than this times `Reach.begin_m` follows its plan again."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ReachMemory:
    """Memory of one world."""

    is_reaching: jax.Array
    """bool [R] whether each robot's end effector is brought to its goal."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Reach(Policy):
    """Brings end effectors to the goals of robots, which fly their plans until they are near."""

    begin_m: float = 1.2
    """Distance of the base from its goal within which the end effector is brought there."""
    stages: int = field(default=3, metadata={"static": True})
    """Number of stages of the controllers that begin with a new memory when it is."""

    def reset(self, inputs: PolicyInput, key: jax.Array) -> ReachMemory:
        """See `Policy.reset`."""
        return ReachMemory(is_reaching=jnp.zeros(inputs.goal_m.shape[0], bool))

    def act(
        self, carry: ReachMemory, inputs: PolicyInput, key: jax.Array, step: jax.Array
    ) -> tuple[ReachMemory, MixedCommand]:
        """See `Policy.act`."""
        distance = jnp.sqrt(jnp.sum((inputs.belief.p - inputs.goal_m) ** 2, axis=-1))
        limit = jnp.where(carry.is_reaching, END_FACTOR * self.begin_m, self.begin_m)
        is_reaching = distance < limit
        still, level = jnp.zeros_like(inputs.goal_m), jnp.zeros_like(inputs.belief.q)
        target = EndEffectorTarget(
            position_m=inputs.goal_m,
            q=level.at[:, 0].set(1.0),
            velocity_mps=still,
            angular_velocity_radps=still,
            is_oriented=jnp.zeros(is_reaching.shape, bool),
        )
        begins = is_reaching & ~carry.is_reaching
        command = MixedCommand(
            which=is_reaching.astype(jnp.int32),
            fresh=jnp.where(begins, self.stages, 0).astype(jnp.int32),
            commands=(inputs.path, target),
        )
        return ReachMemory(is_reaching=is_reaching), command
