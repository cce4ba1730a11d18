"""Policies and planners on one scene, through any session.

A policy of a batch is called here by the loop of the host, with the same function: the estimate of
the robots comes from the session's observation, information on the scenery from the scene behind
it. A `Problem` of any time is built in the same way.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.planning import build_problem
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.runs.session.interface import Observation, Session, SessionCommand
from angler_mjx.runs.session.recording import Recordable
from angler_mjx.runs.simulator.world_preparation import problem_settings
from angler_mjx.sim import policy as policies
from angler_mjx.sim.information import Information
from angler_mjx.sim.information import SceneObservation as Seen
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy, PolicyInput, PolicyMemory
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import FleetWorld, Outcome
from angler_mjx.sim.world_context import WorldContext
from angler_mjx.world.acoustics.config import refuse_acoustics
from angler_mjx.world.obstacles import ObstacleState

type _Scene = tuple[FleetWorld, VehicleState, ObstacleState]

ACTIVE_OUTCOMES = (Outcome.RUNNING, Outcome.REACHED)


class OnlineScene(Session, Recordable, Protocol):
    """Session with access to its scene."""


class OnlineFlyer:
    """Policy that commands the robots of a session."""

    def __init__(self, session: OnlineScene, policy: Policy | None = None) -> None:
        """Compile the policy and start it; the session is at its reset.

        Args:
            session: session that the policy commands.
            policy: policy; the scenario's if left out.

        Raises:
            ConfigError: the scenario has no policy, or the session does not take its commands.
        """
        internals = session.inside()
        active_policy = internals.simulator.policy if policy is None else policy
        if active_policy is None:
            raise ConfigError(
                "no policy: the scenario has no replanning, no order and no policy; set "
                'planner.replan_hz, execution.order = "kept" or policy.name, or give a policy'
            )
        refuse_acoustics(
            internals.simulator.scenario.acoustics,
            'in a session robots know everything of each other; take "perfect", or angler rollout',
        )
        self._session, self._policy = session, active_policy
        spec, stages = internals.simulator.spec, internals.simulator.spec.stages

        def build_inputs(
            world: FleetWorld,
            vehicles: VehicleState,
            obstacles: ObstacleState,
            belief: Belief,
            number: jax.Array,
        ) -> PolicyInput:
            context = WorldContext(
                spec=spec,
                policy=active_policy,
                world=world,
                number=number,
                vehicles=vehicles,
                obstacles=obstacles,
            )
            return context.build_policy_input(belief)

        def begin_memory(scene: _Scene, belief: Belief, number: jax.Array) -> PolicyMemory:
            world, vehicles, obstacles = _single_world(scene)
            inputs = build_inputs(world, vehicles, obstacles, belief, number)
            memory: PolicyMemory = policies.begin_policy(
                active_policy, stages, world.policy_key, inputs
            )
            return memory

        def act(
            memory: PolicyMemory, scene: _Scene, belief: Belief, number: jax.Array
        ) -> tuple[PolicyMemory, Command | MixedCommand]:
            world, vehicles, obstacles = _single_world(scene)
            inputs = partial(build_inputs, world, vehicles, obstacles, belief, number)
            return policies.step(active_policy, world.policy_key, memory, inputs, number)

        self._act: Callable[
            [PolicyMemory, _Scene, Belief, jax.Array], tuple[PolicyMemory, Command]
        ] = jax.jit(act)
        self._begin: Callable[[_Scene, Belief, jax.Array], PolicyMemory] = jax.jit(begin_memory)
        self.restart()
        # Compiled now, and not in the first step of a flight; the result is discarded.
        jax.block_until_ready(self._act(self._memory, *self._scene(session.observe())))

    def restart(self) -> None:
        """Restart the policy after a reset of the session; nothing is compiled again."""
        self._memory = self._begin(*self._scene(self._session.observe()))

    @property
    def memory(self) -> PolicyMemory:
        """Return the memory of the policy."""
        return self._memory

    def commands(self, observation: Observation) -> dict[int, SessionCommand]:
        """Return commands of the running robots for the step that begins now.

        Args:
            observation: present observation of the session.
        """
        self._memory, command = self._act(self._memory, *self._scene(observation))
        host = jax.device_get(command)
        commands: dict[int, SessionCommand] = {}
        for robot, status in enumerate(observation.status):
            if status.outcome in ACTIVE_OUTCOMES:
                commands[robot] = jax.tree.map(lambda leaf, robot=robot: leaf[robot], host)
        return commands

    def _scene(self, observation: Observation) -> tuple[_Scene, Belief, jax.Array]:
        internals = self._session.inside()
        scene = (internals.worlds, internals.state.vehicles, internals.state.obstacles)
        number = np.int32(round(observation.time_s / self._session.dt_s))
        return scene, _build_belief(observation.estimate), as_leaf(number)


def build_session_problem(session: OnlineScene, information: Information | None = None) -> Problem:
    """Build the problem of a session at its present time, from which its times are counted.

    Robots start at their estimated positions.

    Args:
        session: a scene.
        information: levels of the problem; those of the scenario if left out.
    """
    internals, observation = session.inside(), session.observe()
    scenario, spec = internals.simulator.scenario, internals.simulator.spec
    information_level = (
        scenario.planner.information.to_information() if information is None else information
    )
    settings = replace(
        problem_settings(scenario, information_level),
        horizon_s=max(scenario.time.horizon_s - observation.time_s, spec.control_dt_s),
        is_replan=True,
    )
    world, obstacles = _single_world((internals.worlds, internals.state.obstacles))
    w, x, y, z = np.moveaxis(np.asarray(observation.estimate.q, np.float32), -1, 0)
    problem = build_problem.build_problem(
        world,
        jnp.uint32(scenario.seed),
        spec,
        settings,
        Seen(
            time_s=jnp.float32(observation.time_s),
            obstacles=obstacles,
            at_m=jnp.asarray(observation.estimate.p, jnp.float32),
        ),
        jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
    host: Problem = jax.tree.map(np.asarray, problem)
    return host


def _single_world[T](batch: T) -> T:
    """Return the world of a batch of one."""
    world: T = jax.tree.map(lambda leaf: leaf[0], batch)
    return world


def _build_belief(estimate: Estimate) -> Belief:
    """Build the belief of the robots from an estimate, without covariance."""
    p, q, nu = (_to_float32(x) for x in (estimate.p, estimate.q, estimate.nu))
    flow = None if estimate.flow is None else _to_float32(estimate.flow)
    zeros = _to_float32(np.zeros_like(p))
    return Belief(
        p=p,
        q=q,
        nu=nu,
        flow=flow,
        position_std_m=zeros,
        velocity_std_mps=zeros,
        attitude_std_rad=zeros,
    )


def _to_float32(values: ArrayLike) -> jax.Array:
    """Convert to float32 on the host, for a call that moves the values to the device."""
    return as_leaf(np.asarray(values, np.float32))


def __getattr__(name: str) -> object:
    """Return a name of 0.1, with a DeprecationWarning."""
    return _renamed(__name__, name)
