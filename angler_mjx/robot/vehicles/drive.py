"""Axes that thrusters can drive, and the requirements of flying a path.

A level vehicle has four axes: surge, sway, heave and yaw; righting moments hold roll and pitch. An
axis can be driven if thrusters can push along it, in both directions, and along none of the other
three. A path can be flown with surge, heave and yaw: where sway is missing, controllers turn the
bow into the direction of travel. Fins that turn a vehicle in pitch and yaw stand in for heave and
yaw, as long as it moves ahead; a planar vehicle needs no heave.
"""

from dataclasses import dataclass

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.thrusters import FloatArray

MIN_SWAY_FRACTION = 0.1
"""Least sway speed as a fraction of surge; a slower sway counts as missing, because it would limit
the speed along all axes."""

_AXES = {"surge": 0, "sway": 1, "heave": 2, "yaw": 5}
"""Rows of the wrench matrix."""
_ALONE = 1e-2
"""Limit, as a fraction of a push along one axis, of its parts along the others, and as a fraction
of the largest singular value, below which a singular value counts as a small offset of the geometry
(as in `angler_mjx.robot.control.allocation`)."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Abilities of a vehicle at full thrust."""

    terminal_speed_mps: FloatArray
    """[3] surge, sway, heave in still water, the slower direction; 0 for a missing axis."""
    yaw: bool
    """Whether the vehicle can turn about the vertical alone."""
    steers_by_fins: bool = False
    """Whether fins turn it in pitch and yaw when it moves ahead."""
    glides: bool = False
    """Whether it has no thrust, and glides down and up by ballast and a moving mass; its speeds in
    surge and heave are then those of its glide over ground and in depth."""

    @property
    def flies_by_fins(self) -> bool:
        """Return whether it climbs by pitch for lack of heave, or turns by way for lack of yaw."""
        return self.steers_by_fins and not {"heave", "yaw"}.isdisjoint(self.missing_axes)

    @property
    def missing_axes(self) -> tuple[str, ...]:
        """Return the names of the missing axes."""
        available = [*(self.terminal_speed_mps > 0), self.yaw]
        return tuple(
            axis for axis, is_available in zip(_AXES, available, strict=True) if not is_available
        )


def compute_drive(
    B: FloatArray,
    reverse_n: float | FloatArray,
    forward_n: float | FloatArray,
    D_l: FloatArray,
    D_q: FloatArray,
    steers_by_fins: bool = False,
) -> Drive:
    """Compute the abilities of a vehicle from its thrusters and damping.

    Args:
        B: [6, n_t] wrench per newton of each thruster, in F.
        reverse_n: thrust of each thruster at the lowest PWM, N (negative); [n_t] where they differ.
        forward_n: thrust at the highest PWM, N.
        D_l: [3] linear damping of surge, sway, heave, N s/m.
        D_q: [3] quadratic damping, N s^2/m^2.
        steers_by_fins: whether fins turn it in pitch and yaw.
    """
    level = B[list(_AXES.values())]
    reach = level @ np.linalg.pinv(level, rcond=_ALONE)
    alone = np.linalg.norm(reach - np.eye(4), axis=0) < _ALONE
    force = full_force(level, reverse_n, forward_n)
    available = alone & (force > 0)
    speed, can = np.zeros(3), available[:3]
    speed[can] = terminal_speed(force[:3][can], D_l[can], D_q[can])
    if speed[1] < MIN_SWAY_FRACTION * speed[0]:
        speed[1] = 0.0
    return Drive(terminal_speed_mps=speed, yaw=bool(available[3]), steers_by_fins=steers_by_fins)


def require_flyable(config: VehicleConfig, able: Drive) -> None:
    """Refuse a vehicle that cannot fly a path.

    Raises:
        ConfigError: the vehicle lacks an axis; the message names both.
    """
    spared = {"sway", "heave", "yaw"} if able.steers_by_fins or able.glides else {"sway"}
    if config.planar:
        spared |= {"heave"}
    lacking = [axis for axis in able.missing_axes if axis not in spared]
    if lacking:
        raise ConfigError(
            f"vehicle {config.name!r} cannot fly a path: no thrust in {' or '.join(lacking)} "
            "alone, both ways; a path takes surge, heave and yaw, each without the others: add "
            "thrusters or turn those in [thrusters] layout, or give it fins for pitch and yaw; a "
            "glider has none, a tank in [ballast], and in [moving_masses] one along y and one "
            "along x with way enough for its glide, both ways"
        )


def full_force(
    rows: FloatArray, reverse_n: float | FloatArray, forward_n: float | FloatArray
) -> FloatArray:
    """Return the largest force along each axis that can be driven in both directions.

    Each thruster runs at the end of its table that helps: a thruster that points backward pushes in
    reverse to drive the vehicle forward.

    Args:
        rows: [k, n_t] rows of the wrench matrix.
        reverse_n: Thrust at the lowest PWM, N (negative); [n_t] where thrusters differ.
        forward_n: Thrust at the highest PWM, N.

    Returns:
        [k] N.
    """
    positive = np.maximum(rows * forward_n, rows * reverse_n).sum(axis=1)
    negative = np.maximum(-rows * forward_n, -rows * reverse_n).sum(axis=1)
    both: FloatArray = np.minimum(positive, negative)
    return both


def terminal_speed(force_n: FloatArray, D_l: FloatArray, D_q: FloatArray) -> FloatArray:
    """Return the speed at which damping balances a force: the positive root of D_l v + D_q v^2 = F.

    Still water, one axis at a time, net buoyancy left out.

    Returns:
        [k] m/s.
    """
    return 2 * force_n / (D_l + np.sqrt(D_l**2 + 4 * D_q * force_n))


def wrench_matrix(config: VehicleConfig) -> FloatArray:
    """Return the wrench at the centre of mass, in F, per newton of each thruster.

    Column i is [d_i; r_i x d_i - s_i k d_i], r_i from the centre of mass, d_i the direction of
    positive thrust, s_i the spin, k the reaction torque per newton (m).

    Returns:
        [6, n_t]; 1 (first three rows), m.
    """
    layout = config.thrusters.layout
    if not layout or config.rotor is None:
        return np.zeros((6, 0))
    arm = np.array([t.position_m for t in layout]) - np.asarray(config.base.center_of_mass_m)
    direction = np.array([t.direction for t in layout])
    spin = np.array([[t.spin] for t in layout], dtype=np.float64)
    reaction = -config.rotor.reaction_torque.coefficient_m * spin * direction
    wrench: FloatArray = np.concatenate([direction, np.cross(arm, direction) + reaction], axis=1).T
    wrench[np.abs(wrench) < 1e-12] = 0.0  # cosines of right angles
    return wrench
