"""Session of one world of the simulator: each robot takes commands of any level, step by step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands import BodyWrench
from angler_mjx.robot.control.commands.joint_tolerance import Tolerances
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.runs.session import (
    command_preparation,
    command_validation,
    fleet_facts,
    robot_checks,
)
from angler_mjx.runs.session.command_queue import PLAN_COMMAND, CommandQueue
from angler_mjx.runs.session.command_validation import CommandLimits, RobotPosition
from angler_mjx.runs.session.interface import Floats, Observation, RobotInfo, SessionCommand
from angler_mjx.runs.session.rejoin import RejoinPaths
from angler_mjx.runs.session.state_view import (
    StateView,
    WatchedTrajectories,
    apply_belief,
    belief_covariance,
    build_observation,
    view_state,
)
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.scenario.task_table import require_goal_task
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import FleetWorld, WorldState

DEFAULT_POINTS = 256
"""Default number of points of a JointTrajectory."""
DEFAULT_START_TOLERANCE = 0.5
"""Default tolerance, m and rad of yaw, of the start of a path from a robot."""


@dataclass(frozen=True, kw_only=True)
class SessionInternals:
    """Internals of a simulated scene, for recording and plotting; [1] world leads."""

    simulator: Simulator
    worlds: FleetWorld
    state: WorldState
    """Present state."""
    sample: Sample | None
    """Sample of the state before the last step, with the signals of that step; None before the
    first."""


class BatchSession:
    """`Session` over one world of a scenario: the same world as number ``world`` of its runs.

    Everything is compiled in the constructor; no command, however mixed, compiles anything again.
    It runs on JAX's default device as plain XLA, also where a run would use kernels of its own.
    """

    def __init__(
        self,
        scenario: Scenario | str | Path,
        *,
        world: int = 0,
        seed: int | None = None,
        engine: str | None = None,
        points: int = DEFAULT_POINTS,
        start_tolerance: float = DEFAULT_START_TOLERANCE,
        tolerances: Tolerances | None = None,
    ) -> None:
        """Compile the scene and reset it.

        Args:
            scenario: scenario, its name, or its file.
            world: index of the world.
            seed: seed; the scenario's if left out.
            engine: ``mjx`` or ``fused``; the scenario's if left out.
            points: maximum number of points of a JointTrajectory.
            start_tolerance: maximum distance of a path's start from the robot, m and rad; 0 is any
                distance.
            tolerances: tolerances of JointTrajectories, for x, y, z and yaw, or for the joints of
                arms as well; defaults if left out.

        Raises:
            ConfigError: the scenario has faults, or the world, engine or tolerance does not exist.
        """
        self._scenario = _resolve_scenario(scenario, seed, engine)
        if world < 0:
            raise ConfigError(f"world = {world}: worlds are counted from 0")
        self._index, self._tolerances = (
            world,
            command_preparation.stack_tolerances(tolerances, self._scenario),
        )
        self._simulator = Simulator(self._scenario)
        self._dt_s = self._simulator.spec.control_dt_s
        self._points, self._start_tolerance = points, start_tolerance
        self._closed, self._sampled_seed = False, -1
        self.reset()
        self.step()  # compile everything that a step needs
        command_preparation.compile_joins(self._command_queue.slots, self._view)
        self._rejoin_paths.compile()
        self.reset()

    @property
    def robots(self) -> Sequence[RobotInfo]:
        """Return the robots, in order."""
        return self._facts.robots

    @property
    def dt_s(self) -> float:
        """Return the control period, s."""
        return self._dt_s

    def inside(self) -> SessionInternals:
        """Return the internals of the scene, read-only."""
        self._require_open()
        return SessionInternals(
            simulator=self._simulator,
            worlds=self._worlds,
            state=self._state,
            sample=self._sample,
        )

    def reset(self, seed: int | None = None) -> Observation:
        """Reset the scene, see `Session.reset`; other seeds sample another world of scenario."""
        self._require_open()
        number = self._scenario.seed if seed is None else seed
        if number != self._sampled_seed:
            sampled = self._simulator.worlds(self._index, seed=number)
            self._load_world(self._simulator.add_parameters(sampled))
            self._sampled_seed = number
        self._state, self._steps = self._initial_state, 0
        self._sample: Sample | None = None
        dtype = self._initial_state.vehicles.p.dtype
        self._command_queue = CommandQueue(
            self._simulator.spec.stages, self._facts, self._limits, dtype
        )
        neutral = np.full((1, len(self.robots), self._facts.thrusters), NEUTRAL_US, dtype)
        self._view = self._estimated_view = self._view_state(neutral)
        self._target_m: Floats = np.asarray(self._view.p)
        return self.observe()

    def step(self, commands: Mapping[int, SessionCommand] | None = None) -> Observation:
        """Advance one control period; see `Session.step`."""
        self._require_open()
        for robot in commands or {}:
            robot_checks.require_robot(self.robots, robot)
        # Half a period: times are sums in floating point.
        for robot, order in {
            **self._command_queue.due(self._due_before_s),
            **(commands or {}),
        }.items():
            try:
                self.check(robot, order)
            except ConfigError as error:
                self._command_queue.refuse(robot, str(error), self._estimated_view)
            else:
                self._command_queue.give_command(
                    robot, order, self._estimated_view, self._due_before_s
                )
        slot_commands = self._command_queue.slots.commands()
        self._state, self._sample = self._simulator.step(self._worlds, self._state, slot_commands)
        self._steps += 1
        self._view = self._view_state(np.asarray(self._sample.pwm_us))
        self._target_m = np.asarray(self._sample.target_m)[0]
        self._estimated_view = apply_belief(self._view, self._sample.belief)
        self._command_queue.report(self._estimated_view)
        return self.observe()

    def observe(self) -> Observation:
        """Return the present scene; see `Session.observe`."""
        self._require_open()
        return build_observation(
            self._facts,
            self._view,
            self._estimated_view,
            time_s=self._time_s,
            covariance=None if self._sample is None else belief_covariance(self._sample.belief),
            target_m=self._target_m,
            status=self._command_queue.status(np.asarray(self._view.outcome).tolist()),
        )

    def check(self, robot: int, command: SessionCommand) -> None:
        """Refuse a command that a robot cannot follow; see `Session.check`."""
        self._require_running(robot)
        info, view = self.robots[robot], self._estimated_view
        position = RobotPosition(
            p=np.asarray(view.p[robot], float),
            yaw_rad=float(view.yaw_rad[robot]),
            arm=() if (arm := view.arm_position(robot)) is None else tuple(arm.tolist()),
        )
        command_validation.check_command(info, position, self._limits, command, self._time_s)

    def resume_plan(self, robot: int) -> None:
        """Resume a robot's plan, see `Session.resume_plan`.

        Moving obstacles are ignored on the way.
        """
        self._require_running(robot)
        name, command_state = self.robots[robot].name, self._command_queue[robot]
        if not self._facts.found[robot]:
            raise ConfigError(f"{name}: has no plan: the planner found no way for it")
        if command_state.command == PLAN_COMMAND:
            return
        clearance = (
            self.robots[robot].radius_m
            + self._scenario.planner.margin_m
            - command_preparation.CLEARANCE_SLACK_M
        )
        p, speed = (
            np.asarray(self._estimated_view.p[robot], float),
            self.robots[robot].cruise_speed_mps,
        )
        velocity = command_preparation.ground_velocity(self._estimated_view, robot)
        yaw = float(self._estimated_view.yaw_rad[robot])
        rejoin_plan = self._rejoin_paths.plan_rejoin(
            p,
            velocity,
            command_state.plan,
            command_state.plan_time_s,
            clearance,
            speed,
            yaw,
            self._estimated_view.arm_position(robot),
        )
        if rejoin_plan is None or rejoin_plan.time_s.size > self._limits.rows(rejoin_plan.kind):
            raise ConfigError(
                f"{name}: no way back to its plan was found from ({p[0]:.2f}, {p[1]:.2f}, "
                f"{p[2]:.2f}) m; bring it nearer"
            )
        self._command_queue.resume(robot, rejoin_plan)

    def close(self) -> None:
        """Release the session; see `Session.close`."""
        self._require_open()
        self._closed = True
        del (
            self._simulator,
            self._worlds,
            self._initial_state,
            self._state,
            self._sample,
            self._rejoin_paths,
        )

    @property
    def _time_s(self) -> float:
        return self._steps * self._dt_s

    @property
    def _due_before_s(self) -> float:
        """Return the time by which orders are due in the step that begins now."""
        return (self._steps + 0.5) * self._dt_s

    @property
    def _limits(self) -> CommandLimits:
        return self._facts.command_limits(self._points, self._start_tolerance)

    def _require_open(self) -> None:
        if self._closed:
            raise RunError("the session is closed; make a new one")

    def _require_running(self, robot: int) -> None:
        """Refuse to command a robot that failed."""
        self._require_open()
        robot_checks.require_running(self.robots, robot, self._view.outcome)

    def _load_world(self, worlds: FleetWorld) -> None:
        """Load a world, and its facts at the start."""
        self._worlds = worlds
        self._facts = fleet_facts.gather_facts(self._simulator, worlds)
        state = self._simulator.reset(worlds)
        # On the device of the others: a leaf elsewhere would have the step compiled once more.
        nu = state.vehicles.nu
        no_demand = jax.device_put(np.full(nu.shape, np.nan, nu.dtype), nu.sharding)
        carry = replace(state.carry, demanded=BodyWrench(tau=no_demand))
        self._initial_state: WorldState = replace(state, carry=carry)
        # On the host: an index on the device is a program each.
        environment = jax.device_get(worlds.environment)
        self._rejoin_paths = RejoinPaths(jax.tree.map(lambda leaf: leaf[0], environment))

    def _view_state(self, pwm_us: np.ndarray) -> StateView:
        watched, slots = None, self._command_queue.slots
        if JointTrajectory in slots.kinds:
            watched = WatchedTrajectories(
                trajectory=slots.slot(JointTrajectory),
                allowed=self._tolerances,
                before=jax.device_put(self._command_queue.results),
            )
        view: StateView = jax.device_get(view_state(self._worlds, self._state, pwm_us, watched))
        return view


def _resolve_scenario(
    scenario: Scenario | str | Path, seed: int | None, engine: str | None
) -> Scenario:
    """Return the scenario with its overrides, one world at a time."""
    resolved = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    require_goal_task(
        resolved.task,
        'a session has no tasks but "goal" and "carry"; fly it with angler rollout, or take a '
        "scenario of these types",
        also=(CarryTask,),
    )
    changes: dict[str, object] = {"tile": 1, "kernels": "xla"}
    if engine not in (None, "mjx", "fused"):
        raise ConfigError(f"engine = {engine!r}: give mjx or fused")
    if engine is not None:
        changes["engine"] = engine
    if seed is not None:
        changes["seed"] = seed
    return resolved.model_copy(update=changes)
