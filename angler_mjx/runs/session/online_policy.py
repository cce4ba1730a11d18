"""Policies and planners on one scene, through any session.

A policy of a batch is called here by the loop of the host, with the same function: the estimate of
the robots comes from the session's observation, information on the scenery from the scene behind
it. A `Problem` of any time is built in the same way.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from angler_kernels import quaternion
from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.planning import build_problem
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands import Estimate, PoseTarget
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.runs.session.command_queue import PLAN_COMMAND
from angler_mjx.runs.session.interface import Observation, Session, SessionCommand
from angler_mjx.runs.session.recording import Recordable
from angler_mjx.runs.simulator.world_preparation import problem_settings
from angler_mjx.sim import policy as policies
from angler_mjx.sim.information import Information
from angler_mjx.sim.information import SceneObservation as Seen
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy, PolicyInput, PolicyMemory
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import FleetWorld, Outcome
from angler_mjx.sim.world_context import WorldContext
from angler_mjx.world.acoustics.config import refuse_acoustics
from angler_mjx.world.obstacles import ObstacleState

type _Scene = tuple[FleetWorld, VehicleState, ObstacleState, Grips | None]

PATHS = (Trajectory, JointTrajectory)
"""Types of commands that sessions follow as a plan, given once."""

ACTIVE_OUTCOMES = (Outcome.RUNNING, Outcome.REACHED)

SEARCH_PERIOD_S = 1.0
"""Time from one search for a way back to a plan to the next, for a robot that found none."""


def _warn(text: str) -> None:
    warnings.warn(text, RuntimeWarning, stacklevel=2)


class OnlineScene(Session, Recordable, Protocol):
    """Session with access to its scene."""


class OnlineFlyer:
    """Policy that commands the robots of a session."""

    def __init__(
        self,
        session: OnlineScene,
        policy: Policy | None = None,
        report: Callable[[str], None] = _warn,
    ) -> None:
        """Compile the policy and start it; the session is at its reset.

        Args:
            session: session that the policy commands.
            policy: policy; the scenario's if left out.
            report: receives one line on each robot that finds no way back to its plan; a
                RuntimeWarning if left out.

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
        self._session, self._policy, self._report = session, active_policy, report
        spec, stages = internals.simulator.spec, internals.simulator.spec.stages

        def build_inputs(
            world: FleetWorld,
            vehicles: VehicleState,
            obstacles: ObstacleState,
            grips: Grips | None,
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
                grips=grips,
            )
            return context.build_policy_input(belief)

        def begin_memory(scene: _Scene, belief: Belief, number: jax.Array) -> PolicyMemory:
            world, vehicles, obstacles, grips = _single_world(scene)
            inputs = build_inputs(world, vehicles, obstacles, grips, belief, number)
            memory: PolicyMemory = policies.begin_policy(
                active_policy, stages, world.policy_key, inputs
            )
            return memory

        def act(
            memory: PolicyMemory, scene: _Scene, belief: Belief, number: jax.Array
        ) -> tuple[PolicyMemory, Command | MixedCommand]:
            world, vehicles, obstacles, grips = _single_world(scene)
            inputs = partial(build_inputs, world, vehicles, obstacles, grips, belief, number)
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
        self._search_due_s: dict[int, float] = {}
        self._holding: set[int] = set()
        self._reported: set[int] = set()

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
            if status.outcome not in ACTIVE_OUTCOMES:
                continue
            chosen = jax.tree.map(lambda leaf, robot=robot: leaf[robot], host)
            if isinstance(chosen, MixedCommand):
                is_fresh = bool(chosen.fresh)
                chosen = chosen.commands[int(chosen.which)]
                if isinstance(chosen, PATHS) and not is_fresh:
                    hold = self._follow_path(robot, observation)
                    if hold is not None:
                        commands[robot] = hold
                    continue
            self._holding.discard(robot)
            commands[robot] = chosen
        return commands

    def _follow_path(self, robot: int, observation: Observation) -> SessionCommand | None:
        """Have a robot go on along its path: given again, it would begin anew in the session.

        A robot that was commanded otherwise is led back to its plan. One that finds no way back
        holds its position, and searches again every `SEARCH_PERIOD_S`.

        Returns:
            Command to hold the position, once; None of a robot that follows its path or holds.
        """
        command = observation.status[robot].command
        is_holding = robot in self._holding and command != PLAN_COMMAND
        if not is_holding and command in (PLAN_COMMAND, *(kind.__name__ for kind in PATHS)):
            self._holding.discard(robot)
            return None
        # Half a period: times are sums in floating point.
        now_s = observation.time_s + 0.5 * self._session.dt_s
        if now_s >= self._search_due_s.get(robot, 0.0):
            try:
                self._session.resume_plan(robot)
            except ConfigError as error:
                self._search_due_s[robot] = observation.time_s + SEARCH_PERIOD_S
                self._report_once(robot, str(error))
            else:
                self._holding.discard(robot)
                return None
        if is_holding:
            return None
        self._holding.add(robot)
        return _hold_position(self._session.robots[robot].accepts, observation, robot)

    def _report_once(self, robot: int, reason: str) -> None:
        """Report why a robot does not follow its plan, the first time in a flight."""
        if robot not in self._reported:
            self._reported.add(robot)
            self._report(
                f"{reason}. The policy wants it to follow its plan: it holds its position, and "
                f"searches again every {SEARCH_PERIOD_S:g} s"
            )

    def _scene(self, observation: Observation) -> tuple[_Scene, Belief, jax.Array]:
        internals = self._session.inside()
        state = internals.state
        scene = (internals.worlds, state.vehicles, state.obstacles, state.grips)
        number = np.int32(round(observation.time_s / self._session.dt_s))
        return scene, _build_belief(observation.estimate), as_leaf(number)


def build_session_problem(session: OnlineScene, information: Information | None = None) -> Problem:
    """Build the problem of a session at its present time, from which its times are counted.

    Robots start at their estimated positions, arms in their present postures.

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
    joints = observation.estimate.joints
    # NaN of a robot without an arm; no number has a meaning there.
    posture = None if joints is None else _to_float32(np.nan_to_num(np.asarray(joints.position)))
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
        posture,
    )
    host: Problem = jax.tree.map(np.asarray, problem)
    return host


def _hold_position(
    accepts: tuple[type, ...], observation: Observation, robot: int
) -> PoseTarget | Trajectory:
    """Return a command to stay where the robot is; every stack takes a path, not every a pose."""
    position_m, q = (
        np.asarray(part[robot], np.float32)
        for part in (observation.estimate.p, observation.estimate.q)
    )
    if PoseTarget in accepts:
        yaw_rad = as_leaf(np.asarray(quaternion.yaw(as_leaf(q)), np.float32))
        still = as_leaf(np.zeros(3, np.float32))
        return PoseTarget(position_m=as_leaf(position_m), velocity_mps=still, yaw_rad=yaw_rad)
    return Trajectory(
        time_s=as_leaf(np.zeros(1, np.float32)),
        position_m=as_leaf(position_m[None]),
        found=as_leaf(np.asarray(True)),
    )


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
