"""The vehicles that are flown: every shipped rigid one with every parameter set."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import allocation, stages
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.stack import Command, ControlParams
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.rotor_config import RotorResponse
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.state import SimSpec
from angler_mjx.studies.flights import courses
from angler_mjx.studies.flights.courses import CourseTimes

BATTERY_V = 16.0
"""Of four lithium cells, nearly full."""
CRUISE_MPS = 0.5
"""What the controllers are told to cruise at; the pose loop allows 1.5 times as much."""


@dataclass(frozen=True, kw_only=True)
class FlightKind:
    """One vehicle with one of its parameter sets."""

    vehicle: str
    parameter_set: str

    @property
    def label(self) -> str:
        """As tables name it."""
        return f"{self.vehicle}, {self.parameter_set}"


@cache
def shipped_vehicles() -> tuple[FlightKind, ...]:
    """Every rigid ROV that is shipped, with each of its published parameter sets."""
    return tuple(
        FlightKind(vehicle=name, parameter_set=chosen)
        for name in library.list_rovs()
        if not library.load_vehicle(name).links
        for chosen in library.load_vehicle(name).published_sets
    )


def build_params(
    kinds: Sequence[FlightKind],
    battery_v: Sequence[float] | None = None,
    rotor_response: RotorResponse | None = None,
) -> ControlParams:
    """Parameters of robots, one of each kind (host side).

    Args:
        kinds: n of them.
        battery_v: [n] V; ``BATTERY_V`` for all if left out.
        rotor_response: first or third order; what the vehicle files say if left out.

    Returns:
        [n] leads.
    """
    volts = [BATTERY_V] * len(kinds) if battery_v is None else battery_v
    configs = {name: library.load_vehicle(name) for name in {kind.vehicle for kind in kinds}}
    stacked = params.stack_vehicles(
        [
            params.build_vehicle(
                configs[kind.vehicle], kind.parameter_set, volt, rotor_response=rotor_response
            )
            for kind, volt in zip(kinds, volts, strict=True)
        ]
    )
    return ControlParams(
        vehicle=stacked,
        allocation=allocation.build_allocation(stacked),
        cruise_speed_mps=jnp.full(len(kinds), CRUISE_MPS),
    )


@cache
def find_unstabilised() -> frozenset[FlightKind]:
    """The shipped vehicles that nothing holds level: neither weight nor thrusters.

    No controller can be asked to keep the attitude of a vehicle with its centre of buoyancy no
    higher than its centre of mass, and with thrusters that cannot both roll and pitch it.
    """
    vehicles = shipped_vehicles()
    params = build_params(vehicles)
    rights = np.asarray(params.vehicle.p_cb_m)[:, 2] > 0.0
    commanded = np.any(np.asarray(params.allocation.B_inverse)[:, :, 3:5] != 0.0, axis=1)
    level = rights | commanded.all(axis=1)
    return frozenset(kind for kind, held in zip(vehicles, level, strict=True) if not held)


def spec_of(controller: str) -> SimSpec:
    """Settings of a flight with a stack that has a name, with its default gains.

    Raises:
        ConfigError: there is no such stack.
    """
    if controller not in stages.CONTROLLERS:
        raise ConfigError(
            f"unknown controller {controller!r}; there is {', '.join(stages.CONTROLLERS)}"
        )
    stack, gains = stages.build_stack(stages.CONTROLLERS[controller], {})
    return SimSpec(stages=stack, gains=gains)


def holds_poses(spec: SimSpec) -> bool:
    """Whether a stack can be told a pose; those that cannot go along way-points, their own way."""
    return any(PoseTarget in stage.takes for stage in spec.stages)


def keeps_time(spec: SimSpec) -> bool:
    """Whether a stack follows a trajectory in time; those that do not follow its path alone."""
    return any(JointTrajectory in stage.takes for stage in spec.stages)


def build_command(spec: SimSpec, steps_m: FloatArray, yaw_rad: FloatArray) -> Command:
    """Steps from the start as a stack takes them; [n] leads.

    Args:
        spec: whose stages are told.
        steps_m: [n, 3] in W.
        yaw_rad: [n] headings, for those that hold poses; the others go along straight paths at
            cruise speed, their nose where they like.
    """
    if holds_poses(spec):
        return courses.pose_commands(courses.START_M + steps_m, yaw_rad)
    # Both ends of a path are enough.
    times = CourseTimes(flight_s=1.0, point_s=1.0, dt_s=1.0)
    return courses.build_command(
        [courses.follow_line(step, CRUISE_MPS, times) for step in steps_m], timed=False
    )


def select_rows[T](tree: T, rows: Sequence[int]) -> T:
    """Rows of a pytree of arrays, by number."""
    index = np.asarray(rows)
    chosen: T = jax.tree.map(lambda leaf: leaf[index], tree)
    return chosen
