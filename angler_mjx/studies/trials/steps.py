"""Steps of position and heading: rise, overshoot, settling, steady error, oscillation."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.vehicles.rotor_config import RotorResponse
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.studies.flights import courses, flying, kinds, tracks
from angler_mjx.studies.flights.flying import FlightSettings
from angler_mjx.studies.flights.kinds import FlightKind
from angler_mjx.world.currents import Uniform

AXES = ("x", "y", "z", "yaw")
SIZES = (2.0, 2.0, 2.0, math.pi / 2)
"""Of the steps, m and rad."""
CURRENTS_MPS = (0.0, 0.5)
"""Still water, and a current towards y: from the side of a vehicle that heads along x."""
FLIGHT_S = 60.0
LAST_S = 10.0
"""The end of a flight, where it is to be steady."""


@dataclass(frozen=True, kw_only=True)
class TrialStep:
    """What came of one step."""

    kind: FlightKind
    axis: str
    current_mps: float
    response: FloatArray
    """[t] share of the step that is done."""
    rise_s: float
    """From 10 % to 90 %; nan if it never came there."""
    overshoot: float
    """Share of the step."""
    settling_s: float
    """When it came within ``tracks.BAND`` of the target for good; inf if never."""
    error_m: float
    """Greatest distance from the target over the last ``LAST_S``."""
    error_rad: float
    """Greatest error of heading over the last ``LAST_S``; nan if it was not told one."""
    swings: bool
    """Oscillates without end over the last ``LAST_S`` (`tracks.is_oscillating`)."""
    tilt_rad: float
    """Greatest tilt of the flight."""


@dataclass(frozen=True, kw_only=True)
class TrialFlight:
    """All steps of a controller."""

    time_s: FloatArray
    """[t]."""
    steps: tuple[TrialStep, ...]


def fly_steps(
    controller: str, vehicles: Sequence[FlightKind], rotor_response: RotorResponse | None = None
) -> TrialFlight:
    """Fly all steps of some vehicles with a controller, in still water and in a current.

    A controller of paths chooses its own heading: it flies no step of yaw.

    Args:
        controller: name of the stack.
        vehicles: what is flown.
        rotor_response: first or third order; what the vehicle files say if left out.
    """
    spec = kinds.spec_of(controller)
    holds_poses = kinds.holds_poses(spec)
    axes = range(len(AXES) if holds_poses else 3)
    cases = list(itertools.product(range(len(vehicles)), axes, CURRENTS_MPS))
    rows = [row for row, _, _ in cases]
    goals = np.array([SIZES[axis] * np.eye(4)[axis] for _, axis, _ in cases])
    flows = np.array([[0.0, flow, 0.0] for _, _, flow in cases])
    params = kinds.select_rows(kinds.build_params(vehicles, rotor_response=rotor_response), rows)
    settings = FlightSettings(
        params=params,
        plant=params.vehicle,
        start_m=flying.start_positions(len(cases)),
        yaw_rad=jnp.zeros(len(cases)),
        command=kinds.build_command(spec, goals[:, :3], goals[:, 3]),
        current=(Uniform(velocity_mps=jnp.asarray(flows, float)),),
    )
    n_step = round(FLIGHT_S / spec.control_dt_s)
    gains = flying.same_gains(spec, len(cases))
    track = tracks.build_track(spec, flying.build_program(spec, n_step)(settings, gains))
    moved = track.position_m - courses.START_M
    pose = np.concatenate([moved, track.yaw_rad[..., None]], axis=-1)
    steps = []
    for i, (row, axis, flow) in enumerate(cases):
        response = pose[i, :, axis] / SIZES[axis]
        last = -round(LAST_S / spec.control_dt_s)
        off = tracks.pose_error(pose[i, last:], goals[i])
        rise = tracks.rise_of(track.time_s, response)
        settling = tracks.settling_of(track.time_s, response)
        steps.append(
            TrialStep(
                kind=vehicles[row],
                axis=AXES[axis],
                current_mps=flow,
                response=response,
                rise_s=rise,
                overshoot=max(0.0, float(response.max()) - 1.0),
                settling_s=settling,
                error_m=float(np.linalg.norm(off[:, :3], axis=1).max()),
                error_rad=float(np.abs(off[:, 3]).max()) if holds_poses else math.nan,
                swings=tracks.is_oscillating(pose[i], last),
                tilt_rad=float(track.tilt_rad[i].max()),
            )
        )
    return TrialFlight(time_s=track.time_s, steps=tuple(steps))
