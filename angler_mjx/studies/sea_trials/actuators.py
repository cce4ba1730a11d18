"""Commands of a vehicle's actuators: pushes along one axis, and steering.

A command holds a number for each actuator: thrusts in N, then deflections of fins in rad, whose
columns of `Actuators.effect` are the wrench per rad at the terminal speed ahead.
"""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import jax
import numpy as np

from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.fins import build_fins, fin_matrix
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.robot.vehicles.properties import describe_vehicle
from angler_mjx.robot.vehicles.thrust_curves import build_thrust_tables, thrust_ends
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.sim.physics.step import VehicleState, Water

type Axis = Literal["surge", "sway", "heave", "yaw"]
type Command = FloatArray
"""[n] thrusts, N, and deflections, rad."""

_ROWS: dict[Axis, int] = {"surge": 0, "sway": 1, "heave": 2, "yaw": 5}
_ALL_ROWS = list(range(6))
_LEVEL_ROWS = list(_ROWS.values())
_ALONE = 1e-2
"""Largest part of a push along other axes, as in `angler_mjx.robot.vehicles.drive`."""
_ASIDE = 0.1
"""Largest surge of an actuator that steers, as a fraction of its force."""
_NONE = 1e-9


@dataclass(frozen=True, kw_only=True)
class Actuators:
    """Actuators of one vehicle."""

    effect: FloatArray
    """[6, n] wrench in F per unit of each command."""
    lower: Command
    """[n] least command."""
    upper: Command
    """[n] greatest command."""
    fins: int = 0
    """Number of fins, tanks and moving masses, the last of the actuators: fins push with way on and
    not from rest, the others stay in the middle."""

    def push(self, axis: Axis, sign: int) -> Command | None:
        """Return the command of the greatest push along an axis; None where there is none.

        Each actuator that pushes along the axis is at its limit, as for the terminal speeds of
        `angler vehicle show`, and the others cancel what it does aside. Where they cannot, all are
        scaled until nothing is left aside. Roll and pitch are cancelled too where the actuators
        can; else the righting moments hold them.

        Args:
            axis: of F.
            sign: 1 or -1; forward, left, up and turning left are positive.
        """
        can_push = np.arange(self.effect.shape[1]) < self.effect.shape[1] - self.fins
        all_effect = np.where(can_push, self.effect, 0.0)
        push = sign * all_effect[_ROWS[axis]]
        if not np.any(np.abs(push) > _NONE):
            return None
        full = np.where(push > 0, self.upper, self.lower)
        full = np.where(np.abs(push) > _NONE, full, 0.0)
        other = np.abs(push) <= _NONE
        for used, rows in product((other, np.full(other.shape, True)), (_ALL_ROWS, _LEVEL_ROWS)):
            effect = all_effect[rows]
            along = np.zeros(len(rows))
            along[rows.index(_ROWS[axis])] = sign
            aside = effect @ full - (along @ effect @ full) * along
            command = full - np.linalg.pinv(np.where(used, effect, 0.0), rcond=_ALONE) @ aside
            command = command * self._reach(command)
            wrench = effect @ command
            force = float(along @ wrench)
            if force > _NONE and np.linalg.norm(wrench - force * along) < _ALONE * force:
                return command
        return None

    def steer(self, sign: int) -> Command | None:
        """Return the command of the greatest steering; None where nothing turns the vehicle.

        A push in yaw alone, or else all actuators that turn the vehicle without pushing it ahead,
        as a rudder or a thruster across the stern does.

        Args:
            sign: 1 to port, -1 to starboard.
        """
        alone = self.push("yaw", sign)
        if alone is not None:
            return alone
        turning = sign * self.effect[_ROWS["yaw"]]
        force = np.linalg.norm(self.effect[:3], axis=0)
        used = (np.abs(turning) > _NONE) & (np.abs(self.effect[_ROWS["surge"]]) < _ASIDE * force)
        command = np.where(used, np.where(turning > 0, self.upper, self.lower), 0.0)
        return command if np.any(command) else None

    def _reach(self, command: Command) -> float:
        """Return the factor, at most 1, that brings a command within the limits."""
        limit = np.where(command > 0, self.upper, self.lower)
        used = np.abs(command) > _NONE
        return float(np.min(limit[used] / command[used], initial=1.0))


def build_actuators(config: VehicleConfig, voltage_v: float) -> Actuators:
    """Return the actuators of a vehicle at a voltage.

    Raises:
        ConfigError: the voltage lies outside the thruster's data.
    """
    thrust_n, _ = build_thrust_tables(config, voltage_v)
    effect = wrench_matrix(config)
    count = effect.shape[1]
    lower, upper = (np.broadcast_to(end, (count,)) for end in thrust_ends(thrust_n))
    fins = build_fins(config)
    if fins is not None:
        speed_mps = float(describe_vehicle(config, None, voltage_v).terminal_speed_mps[0])
        rows = slice(count, count + len(config.fins.layout) if config.fins else count)
        by_fins = 0.5 * Water().density_kgpm3 * speed_mps**2 * fin_matrix(config)[:, rows]
        limit = np.asarray(fins.limit_rad, float)[rows]
        effect = np.concatenate([effect, by_fins], axis=1)
        lower, upper = np.concatenate([lower, -limit]), np.concatenate([upper, limit])
    held = np.zeros(len(config.tanks) + len(config.masses))
    if held.size:
        effect = np.concatenate([effect, np.zeros((6, held.size))], axis=1)
        lower, upper = np.concatenate([lower, held]), np.concatenate([upper, held])
    return Actuators(effect=effect, lower=lower, upper=upper, fins=effect.shape[1] - count)


def advance(
    params: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    t: jax.Array,
    dt_s: float,
    water: Water,
) -> VehicleState:
    """Advance a vehicle in still water by one physics step of the batch engines.

    Args:
        params: of the vehicle.
        state: at time t.
        command: [n] of its actuators, held over the step.
        t: [] s.
        dt_s: step.
        water: the medium.
    """
    engine = ClosedForm(gravity_mps2=water.gravity_mps2)
    return physics.step(engine, params, params, state, command, (), t, dt_s, water)
