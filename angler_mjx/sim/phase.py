"""What a phase of a control step is, and what an engine gives it; the phases are in `step`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import jax

from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import SimSpec
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import ObstacleState

type Slots = Mapping[str, Any]
"""What phases read and give, by name.

Of robots: ``vehicle`` `VehicleState`, ``memory`` of the controllers, ``tally`` `Tally`; within one
step also ``known`` (`Belief`, or the vehicle where robots are told the truth), ``thrust_n``,
``power_w``, ``before_m``, ``broken``. Of obstacles: ``obstacles`` `ObstacleState`. Of worlds:
``senses``, ``modem``, ``task`` and ``policy``, their memories; within one step ``known``, ``heard``
(bool [R, R], who understood a packet of whom), ``command``,
``finished`` and ``loaded``.
"""


class BatchContext(Protocol):
    """Where an engine runs a phase of robots or obstacles.

    Fields of one body lead with whatever the engine works on: robots of a world, or lanes.
    """

    @property
    def spec(self) -> SimSpec:
        """Settings."""

    @property
    def t(self) -> jax.Array:
        """[] s at the beginning of the control step."""

    @property
    def params(self) -> ControlParams:
        """What controllers know of the robots."""

    @property
    def command(self) -> Any:
        """To the controllers: the robots' paths, or what drives them instead."""

    @property
    def current(self) -> Current:
        """Of the water."""

    @property
    def goal_m(self) -> Any:
        """[3] in W."""

    @property
    def finished(self) -> Any:
        """Bool [] whether a robot's part of the task is done; None where there is no task."""

    @property
    def fails_at_s(self) -> Any:
        """[] s when a robot breaks down; None where none can."""

    @property
    def last_approach_s(self) -> Any:
        """[] s on the robots' plans, of `plans.last_approach_s`; None where they fly no plans."""

    @property
    def approaching(self) -> Any:
        """Bool [] whether robots are on the last approach of plans that a policy keeps, or None."""

    @property
    def corners(self) -> tuple[Any, Any]:
        """Lower and upper corner [3] of the region, m, in W."""

    def flow(self, vehicle: VehicleState) -> Any:
        """[3] velocity of the water at the robots at the beginning of the step, m/s, in W."""

    def map_bodies(
        self, function: Callable[..., Any], *bodies: Any, shared: tuple[Any, ...] = ()
    ) -> Any:
        """A function of one body for all; ``shared`` is what all of a world have in common."""

    def repeat(self, times: int, body: Callable[[jax.Array, Any], Any], tree: Any) -> Any:
        """``body(i, tree)`` a number of times."""

    def physics_step(
        self,
        params: ControlParams,
        vehicle: VehicleState,
        thrust_n: Any,
        current: Current,
        t: jax.Array,
    ) -> VehicleState:
        """One physics step of all robots, for the thrusts that their signals settle at."""

    def advance(self, obstacles: ObstacleState) -> ObstacleState:
        """The obstacles one control period later."""

    def contact(self, now: Slots) -> Contact:
        """The nearest thing to each robot, among all that have moved."""


def no_slots() -> dict[str, Any]:
    """What a phase gives that gives nothing."""
    return {}


@dataclass(frozen=True, kw_only=True)
class PhaseResult:
    """What came of a phase, worked out when it is asked for.

    The record is asked for first, while what it tells of is at hand, and by kernels only in those
    steps of which a sample is kept.
    """

    slots: Callable[[], dict[str, Any]]
    record: Callable[[], dict[str, Any]] = no_slots
    """Fields that `angler_mjx.sim.record` declares for the phase."""


@dataclass(frozen=True, kw_only=True)
class Phase:
    """One phase of a control step."""

    name: str
    of: Literal["world", "robot", "obstacle"]
    run: Callable[[Any, Slots], PhaseResult]
    """Of `BatchContext` (`WorldContext` for worlds) and what it reads; pure."""
    reads: tuple[str, ...]
    gives: tuple[str, ...]
    meets: bool = False
    """Whether it looks at other bodies: it begins when all have gone through the phases before."""


def run_phases(context: Any, phases: tuple[Phase, ...], slots: Slots) -> tuple[dict[str, Any], Any]:
    """Phases one after another.

    Returns:
        All slots after them, and what they recorded, by field.
    """
    now, record = dict(slots), dict[str, Any]()
    for phase in phases:
        with jax.named_scope(phase.name):
            done = phase.run(context, now)
            record.update(done.record())
            now.update(done.slots())
    return now, record
