"""Where phases of worlds are run: one world, and what its robots may know of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.periods import every_n_steps
from angler_mjx.robot.control import stack
from angler_mjx.sim import information, sensing
from angler_mjx.sim.cargo import read_grips
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.information import ObstacleInformation, SceneObservation
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy, PolicyInput
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import FleetWorld, SimSpec
from angler_mjx.world import currents
from angler_mjx.world.acoustics.channel import HeardRobots
from angler_mjx.world.obstacles import ObstacleState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GoalAssignment:
    """Where robots are to go, [R] leading."""

    goal_m: jax.Array
    """[R, 3] in W."""
    goal_index: jax.Array | None
    """int32 [R] which place of the world's routes that is; -1: none, it stays."""


@dataclass(frozen=True, kw_only=True)
class WorldContext:
    """Where phases of worlds are run: in plain arrays, [R] leading, in every engine."""

    spec: SimSpec
    policy: Policy | None
    world: FleetWorld
    number: jax.Array
    """int32 [] control steps taken."""
    vehicles: VehicleState
    obstacles: ObstacleState | None = None
    """Now; None where no policy asks for them."""
    outcome: jax.Array | None = None
    """int32 [R] of the robots so far; None where there is no task."""
    fleet: Fleet | None = None
    """None where robots carry nothing."""
    grips: Grips | None = None
    """Now; None where robots hold nothing together."""
    every: int = 1
    """The number is a multiple of it, as far as is known when the program is made."""

    @property
    def t(self) -> jax.Array:
        """[] s."""
        return self.number.astype(self.vehicles.p.dtype) * self.spec.control_dt_s

    @property
    def flow(self) -> jax.Array | None:
        """[R, 3] true current at the robots, m/s, in W; None where nobody wants it."""
        if self.policy is None and not stack.wants_flow(self.spec.stages):
            return None
        current = self.world.environment.current
        return jax.vmap(currents.velocity, (None, 0, None))(current, self.vehicles.p, self.t)

    def build_policy_input(
        self,
        belief: Belief | None,
        others: HeardRobots | None = None,
        assignment: GoalAssignment | None = None,
    ) -> PolicyInput:
        """What the robots know, for a policy.

        Args:
            belief: what they are told of their motion; None for the truth.
            others: what they have heard of each other; None where everybody knows everything.
            assignment: where the task sends them; None where each has a goal of its own.
        """
        goals = self._default_goals() if assignment is None else assignment
        joints = self.vehicles.joints
        inputs = PolicyInput(
            belief=sensing.truth_belief(self.vehicles, self.flow) if belief is None else belief,
            time_s=self.t,
            goal_m=goals.goal_m,
            path=self.world.path,
            params=self.world.control,
            others=others,
            routes=self.world.routes,
            goal_index=goals.goal_index,
            joint_position=None if joints is None else joints.position,
            grip=None
            if self.grips is None
            else read_grips(self.grips, self.world.grip_sensors, self.number),
        )
        return self._add_scenery(inputs)

    def _default_goals(self) -> GoalAssignment:
        """Each robot to its goal, which is its place of the routes too."""
        goal_index = None
        if self.world.routes is not None:
            goal_index = jnp.arange(self.world.variant.shape[0], dtype=jnp.int32)
        return GoalAssignment(goal_m=self.world.environment.goal_m, goal_index=goal_index)

    def _add_scenery(self, inputs: PolicyInput) -> PolicyInput:
        """Return inputs with the world around the robots, for a policy that asks for it."""
        if self.policy is None or self.policy.information is None:
            return inputs
        if self.obstacles is None:
            raise RuntimeError("an engine does not say where obstacles are to a policy that asks")
        policy, allowed = self.policy, self.policy.information
        environment, water = self.world.environment, self.spec.water
        at_m, seen = (
            self.vehicles.p,
            SceneObservation(time_s=self.t, obstacles=self.obstacles, at_m=self.vehicles.p),
        )

        def look() -> ObstacleInformation:
            return information.obstacle_information(
                environment,
                allowed,
                policy.ahead_s,
                self.spec.control_dt_s,
                water.density_kgpm3,
                water.gravity_mps2,
                seen,
            )

        return replace(
            inputs,
            grid=environment.grid,
            floor_z_m=environment.floor_z_m,
            obstacles=self._every_n_steps(look, policy.observation_period),
            current=information.current_information(environment, allowed.current, at_m, self.t),
        )

    def _every_n_steps[T](self, look: Callable[[], T], every: int) -> T:
        """What is seen in every n-th control step, and zeros of its shapes in the others."""
        shapes = jax.eval_shape(look)

        def empty() -> T:
            zeros: T = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
            return zeros

        return every_n_steps(every, self.number, look, empty, self.every)
