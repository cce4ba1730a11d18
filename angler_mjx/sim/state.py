"""What a simulated world consists of: its constants, its state, and what is kept of each robot."""

from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Literal

import jax
import jax.numpy as jnp

from angler_mjx.robot.control import plans, stages
from angler_mjx.robot.control.measurements import NavigationCarry
from angler_mjx.robot.control.navigation import NavigationParams
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import ControlMemory, ControlParams, StackGains, Stages
from angler_mjx.robot.sensing.readings import SensorCarry
from angler_mjx.sim.cargo import CargoError, CargoSpec, GripSensors
from angler_mjx.sim.physics.contact.grips import Grips
from angler_mjx.sim.physics.contact.resolve import ContactSpec
from angler_mjx.sim.physics.mjx_engine import BodyInertia
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.sim.policy import PolicyMemory
from angler_mjx.world.acoustics.channel import Channel, ModemState
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import ObstacleState
from angler_mjx.world.routes import Routes
from angler_mjx.world.tasks.spec import TaskSpec, TaskState, TaskWorld

type EngineConstants = tuple[jax.Array, ...]
"""A bank's constants as an engine reads them; see `Engine.pack_constants`."""


type EngineState = object
"""States of worlds as an engine keeps them from step to step; see `Engine.pack_state`."""


class Outcome(IntEnum):
    """How a robot's episode ended; the names are those of the results table."""

    RUNNING = 0
    REACHED = 1
    COLLISION_STATIC = 2
    COLLISION_DYNAMIC = 3
    COLLISION_ROBOT = 4
    OUT_OF_BOUNDS = 5
    TIMEOUT = 6
    DIVERGED = 7
    FAILED = 8
    DAMAGED = 9
    DROPPED = 10


class Touched(IntEnum):
    """What a robot touched; the index beside it counts within the kind."""

    NOTHING = 0
    CELL = 1
    FLOOR = 2
    OBSTACLE = 3
    ROBOT = 4


CASCADE = stages.find_controller("cascade")


@dataclass(frozen=True, kw_only=True)
class InstrumentedRobots:
    """Neighbouring robots of a fleet whose controllers are told what instruments show."""

    first: int
    count: int
    source: Literal["noisy", "ekf"]
    """The true state with white noise, or what a navigation filter makes of instruments."""
    params: NavigationParams
    """[count] leads."""


@dataclass(frozen=True, kw_only=True)
class SimSpec:
    """Settings of the simulation that are fixed while it is compiled."""

    physics_dt_s: float = 0.01
    physics_steps: int = 5
    """Physics steps in one control step; contact is looked for once a control step."""
    goal_tolerance_m: float = 0.3
    """A robot has arrived when its centre is this near to its goal."""
    by_end_effector: bool = False
    """Whether its end effector has to be that near, not its centre."""
    water: Water = field(default_factory=Water)
    stages: Stages = CASCADE
    """The controllers, from the highest down."""
    gains: StackGains = tuple(stage.gains() for stage in CASCADE)
    """Of each stage: numbers in a run; a pytree, so that they can be differentiated
    (`angler_mjx.sim.engines.gradients`)."""
    instrumented: tuple[InstrumentedRobots, ...] = ()
    """All other robots' controllers are told the truth."""
    also: tuple[str, ...] = ()
    """What is recorded only where it is asked for (`angler_mjx.sim.record.RecordOption`)."""
    acoustics: Channel | None = None
    """Acoustic channel between the robots; None: information on others is immediate."""
    task: TaskSpec | None = None
    """What the robots of a world have to do; None where each has a goal of its own."""
    contact: ContactSpec | None = None
    """How bodies push each other; None: the first touch ends a robot's episode."""
    cargo: CargoSpec | None = None
    """What the robots of a world carry together, and where to; None for nothing."""
    leader: int | None = None
    """Robot that the others follow by the force of their grips; None where none leads."""

    @property
    def by_task(self) -> bool:
        """Whether a task of the world says who has finished, not how near a goal is."""
        return self.task is not None or self.cargo is not None

    @property
    def control_dt_s(self) -> float:
        """Control period, s."""
        return self.physics_dt_s * self.physics_steps


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldFactors:
    """What was drawn for one world beside what its files say; its current has its own already."""

    current: jax.Array
    """[] times as fast as drawn."""
    sensor_noise: jax.Array
    """[n_robot] times the noise of the instruments."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class World:
    """Sampled constants of one world during an episode; [n_robot] leads in fleet and paths.

    Nothing in it is derived: the robots' parameters are those of the fleet's ``variant``
    (`angler_mjx.sim.fleet.add_parameters`).
    """

    environment: Environment
    variant: jax.Array
    """int32 [n_robot] which variant of the fleet (vehicle and parameter set) each robot is."""
    cruise_speed_mps: jax.Array
    """[n_robot] speed along a planned path."""
    path: Plan
    """What the robots are told, if nothing else commands them; all of one type."""
    sensing_key: jax.Array | None = None
    """uint32 [n_robot, 2] key of each robot's instruments; None where the fleet has none."""
    policy_key: jax.Array | None = None
    """uint32 [2] key of the world's policy; None where the simulator has none."""
    acoustics_key: jax.Array | None = None
    """uint32 [2] key of the channel that its robots share; None where they share none."""
    factors: WorldFactors | None = None
    """None where current and noise are as the files say."""
    fails_at_s: jax.Array | None = None
    """[n_robot] when each robot breaks down, s; inf for never. None where none can."""
    routes: Routes | None = None
    """Ways to the robots' goals, or to the places of the task; None where no policy asks for
    them."""
    task: TaskWorld | None = None
    """None where each robot has a goal of its own."""
    grip_sensors: GripSensors | None = None
    """Of the robots' grips; None where they hold nothing, or measure it without errors."""

    @property
    def planned(self) -> jax.Array:
        """Bool [n_robot] whether the planner found a way; the others are told to hold."""
        return plans.is_found(self.path)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FleetWorld(World):
    """World with the parameters of its robots; made by `angler_mjx.sim.fleet.add_parameters`."""

    control: ControlParams
    """[n_robot] leads."""
    body: BodyInertia
    """[n_robot] leads; empty where the fleet has no multibody models."""

    @property
    def sampled(self) -> World:
        """The world without what was added."""
        return World(**{entry.name: getattr(self, entry.name) for entry in fields(World)})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Tally:
    """What is kept of each robot; [n_robot] leads. Frozen when its episode ends."""

    outcome: jax.Array
    """int32 [R] an `Outcome`."""
    end_time_s: jax.Array
    """[R] when the episode ended."""
    passed_early: jax.Array
    """bool [R] whether the robot was at its goal before its plan's last approach to it."""
    path_length_m: jax.Array
    """[R] way of the centre of mass."""
    energy_j: jax.Array
    """[R] electrical energy of the thrusters."""
    min_clearance_m: jax.Array
    """[R] least distance of the hull to cells, floor and obstacles, up to the exact radius."""
    min_separation_m: jax.Array
    """[R] least distance of the hull to other hulls; inf in a fleet of one."""
    touched: jax.Array
    """int32 [R] a `Touched`."""
    touched_index: jax.Array
    """int32 [R] obstacle or robot; -1 otherwise."""
    impact_speed_mps: jax.Array
    """[R] relative speed of the centres at the touch; NaN without one. With contact, the speed of
    the surfaces towards each other at the hardest impact."""
    impact_energy_j: jax.Array | None = None
    """[R] energy of the hardest impact; None where a touch ends an episode."""
    contact_depth_m: jax.Array | None = None
    """[R] greatest overlap with another body or the ground; None likewise."""
    grip_force_n: jax.Array | None = None
    """[R] greatest force of the robot's grip; None where robots hold nothing."""
    internal_force_n: jax.Array | None = None
    """[R] greatest force of the grip less the mean of all; None likewise."""
    cargo_error: CargoError | None = None
    """[R] error of what they carry, at the end; None likewise."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SensingMemory:
    """Memory of `InstrumentedRobots`; [count] leads."""

    instruments: SensorCarry
    filter: NavigationCarry


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldState:
    """What changes from step to step in one world."""

    vehicles: VehicleState
    carry: ControlMemory
    """Memory of the controllers."""
    obstacles: ObstacleState
    tally: Tally
    step: jax.Array
    """int32 [] control steps taken."""
    senses: tuple[SensingMemory | None, ...] = ()
    """Of each group of `InstrumentedRobots`; None for noise on the truth, which has no memory."""
    policy: PolicyMemory | None = None
    """Of the policy, where there is one."""
    modem: ModemState | None = None
    """Of the channel that the robots share, if they share one."""
    task: TaskState | None = None
    """Of the task, where there is one."""
    grips: Grips | None = None
    """Of the robots, where they carry something together."""


def replace_worlds(
    state: WorldState, ended: jax.Array, initial: WorldState, rows: jax.Array
) -> WorldState:
    """Return states [W] whose ended worlds are worlds of other states.

    Args:
        state: [W] leads.
        ended: bool [W].
        initial: states that they are taken from, [B] leads.
        rows: int32 [W] whose of them.
    """

    def replace_rows(other: jax.Array, now: jax.Array) -> jax.Array:
        return jnp.where(ended.reshape(-1, *(1,) * (now.ndim - 1)), other[rows], now)

    replaced: WorldState = jax.tree.map(replace_rows, initial, state)
    return replaced
