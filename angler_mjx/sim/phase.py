"""Types of the phases of a control step; the phases of robots and obstacles are in `step`.

A phase is a pure function of a dataclass that holds all that it reads. `BodyBatch` is how an engine
applies a function of one body to all that it works on: robots of a world, or lanes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import jax

from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import GripRecord, JointRecord
from angler_mjx.sim.state import SimSpec
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import ObstacleState

type Record = dict[str, jax.Array | JointRecord | GripRecord]
"""Fields that `angler_mjx.sim.record` declares for a phase."""


class BodyBatch(Protocol):
    """Bodies that an engine works on at once; fields of one body lead with them."""

    @property
    def spec(self) -> SimSpec:
        """Settings."""

    @property
    def t(self) -> jax.Array:
        """[] s at the beginning of the control step."""

    def flow(self, current: Current, vehicle: VehicleState) -> jax.Array:
        """[3] velocity of the water at the robots at the beginning of the step, m/s, in W."""

    def map_bodies[T](
        self, function: Callable[..., T], *bodies: object, shared: tuple[object, ...] = ()
    ) -> T:
        """A function of one body for all; ``shared`` is what all of a world have in common."""

    def repeat[T](self, times: int, body: Callable[[jax.Array, T], T], tree: T) -> T:
        """``body(i, tree)`` a number of times."""

    def physics_step(
        self,
        params: ControlParams,
        vehicle: VehicleState,
        thrust_n: jax.Array,
        current: Current,
        t: jax.Array,
        joints: JointMotion | None,
    ) -> VehicleState:
        """One physics step of all robots, for the thrusts that their signals settle at.

        ``joints`` [J] is what the servos of joints hold; None where no robot has any.
        """

    def advance(self, obstacles: ObstacleState) -> ObstacleState:
        """The obstacles one control period later."""


def no_record() -> Record:
    """Return the record of a phase that records nothing."""
    return {}


@dataclass(frozen=True, kw_only=True)
class PhaseResult[Output]:
    """Result of a phase, computed when it is called for.

    The record is called for first, while what it is made of is at hand, and by kernels only in
    those steps of which a sample is kept.
    """

    output: Callable[[], Output]
    record: Callable[[], Record] = no_record


@dataclass(frozen=True, kw_only=True)
class Phase[Input, Output]:
    """One phase of robots or obstacles in a control step."""

    name: str
    run: Callable[[BodyBatch, Input], PhaseResult[Output]]
    """Pure."""
    takes: type[Input]
    """Dataclass of all that it reads."""
    gives: type[Output]
    """Dataclass of what it changes."""
    of: Literal["robot", "obstacle"] = "robot"
    meets: bool = False
    """Whether it looks at other bodies: it begins when all have gone through the phases before."""


def run_phase[Input, Output](
    phase: Phase[Input, Output], batch: BodyBatch, inputs: Input
) -> tuple[Output, Record]:
    """Return the output of a phase, and what it recorded."""
    with jax.named_scope(phase.name):
        result = phase.run(batch, inputs)
        record = result.record()
        return result.output(), record
