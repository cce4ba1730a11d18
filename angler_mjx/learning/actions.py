"""Actions of an agent: numbers from -1 to 1, scaled to commands of the controllers."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, PoseTarget, ThrusterPwm
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief

POSE_RANGE = (2.0, 2.0, 2.0, 3.14159265)
"""Range of the offset along forward, left (level), up, m, and of the heading, rad."""
TWIST_RANGE = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Range of velocity over ground in F, m/s and rad/s."""
WRENCH_RANGE = (80.0, 80.0, 80.0, 15.0, 15.0, 15.0)
"""Range of the wrench in F, N and N m."""
PWM_RANGE_US = (400.0,)
"""Range of each thruster, us from neutral."""
NEUTRAL_US = 1500.0

type RobotMotion = VehicleState | Belief
"""Motion of the robots, true or estimated."""
type MakeCommand = Callable[[jax.Array, RobotMotion, jax.Array, jax.Array], Command | None]


@dataclass(frozen=True, kw_only=True)
class ActionSpace:
    """Kind of action; ``range`` holds the values of 1, element by element, -1 the opposite."""

    name: str
    unit: str
    size: int
    """Number of action values of each robot."""
    range: tuple[float, ...]
    command: type | None
    """Command to the base that the action becomes; None: the robots follow their plans."""
    make_command: MakeCommand
    """Builds the command from scaled numbers [W, R, size], the robots [W, R, ...], and position [W,
    R, 3] and heading [W, R] of the aim."""


def _make_no_command(_: jax.Array, __: RobotMotion, ___: jax.Array, ____: jax.Array) -> None:
    return None


def _rotate_by_heading(yaw_rad: jax.Array, offset: jax.Array) -> jax.Array:
    """Rotate an offset [..., 3] forward, left and up of a heading into W."""
    c, s = jnp.cos(yaw_rad), jnp.sin(yaw_rad)
    x, y, z = jnp.moveaxis(offset, -1, 0)
    return jnp.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _make_relative_pose(
    a: jax.Array, robots: RobotMotion, _: jax.Array, __: jax.Array
) -> PoseTarget:
    yaw = jax.vmap(jax.vmap(quaternion.yaw))(robots.q)
    return PoseTarget(
        position_m=robots.p + _rotate_by_heading(yaw, a[..., :3]),
        velocity_mps=jnp.zeros_like(robots.p),
        yaw_rad=yaw + a[..., 3],
    )


def _make_aim_pose(
    a: jax.Array, robots: RobotMotion, aim_m: jax.Array, yaw_rad: jax.Array
) -> PoseTarget:
    return PoseTarget(
        position_m=aim_m + _rotate_by_heading(yaw_rad, a[..., :3]),
        velocity_mps=jnp.zeros_like(robots.p),
        yaw_rad=yaw_rad + a[..., 3],
    )


def _make_twist(a: jax.Array, _: RobotMotion, __: jax.Array, ___: jax.Array) -> BodyTwist:
    return BodyTwist(nu=a)


def _make_wrench(a: jax.Array, _: RobotMotion, __: jax.Array, ___: jax.Array) -> BodyWrench:
    return BodyWrench(tau=a)


def _make_pwm(a: jax.Array, _: RobotMotion, __: jax.Array, ___: jax.Array) -> ThrusterPwm:
    return ThrusterPwm(pwm_us=NEUTRAL_US + a)


KINDS: dict[str, tuple[str, tuple[float, ...], type | None, MakeCommand]] = {
    "plan": ("", (), None, _make_no_command),
    "waypoint": ("m, rad; from the robot, level", POSE_RANGE, PoseTarget, _make_relative_pose),
    "pose": ("m, rad; from the aim, level", POSE_RANGE, PoseTarget, _make_aim_pose),
    "twist": ("m/s, rad/s, in F", TWIST_RANGE, BodyTwist, _make_twist),
    "wrench": ("N, N m, in F", WRENCH_RANGE, BodyWrench, _make_wrench),
    "pwm": ("us from 1500", PWM_RANGE_US, ThrusterPwm, _make_pwm),
}
"""Unit, range, command and constructor of each kind of action, by name."""


WHOLE_BODY = "whole_body"
"""Kind of action of vehicles with joints: a twist of the base, and a position of each joint."""


@dataclass(frozen=True, kw_only=True)
class JointRanges:
    """Limits of the joints of the arms of a fleet."""

    lower: tuple[float, ...]
    """[J] rad or m."""
    upper: tuple[float, ...]
    """[J]."""

    @property
    def middle(self) -> tuple[float, ...]:
        """Return the middle [J] of the limits."""
        return tuple(0.5 * (a + b) for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def half(self) -> tuple[float, ...]:
        """Return half of the span [J] of the limits."""
        return tuple(0.5 * (b - a) for a, b in zip(self.lower, self.upper, strict=True))

    def make_command(
        self, a: jax.Array, _: RobotMotion, __: jax.Array, ___: jax.Array
    ) -> WholeBodyCommand:
        """Return the command of numbers [W, R, 6 + J]; see `ActionSpace.make_command`."""
        position = a[..., len(TWIST_RANGE) :] + jnp.asarray(self.middle, a.dtype)
        still = jnp.zeros_like(position)
        return WholeBodyCommand(
            base=BodyTwist(nu=a[..., : len(TWIST_RANGE)]),
            joints=JointTarget(position=position, velocity=still, acceleration=still),
        )


def build_action_space(
    name: str,
    thrusters: int,
    scale: tuple[float, ...] | None = None,
    joints: JointRanges | None = None,
) -> ActionSpace:
    """Build an action space by its name.

    Args:
        name: one of `KINDS`, or `WHOLE_BODY`.
        thrusters: number of thrusters of each robot, padding included.
        scale: other ranges than those of `KINDS`.
        joints: of the arms of the fleet; None where no vehicle has joints.

    Raises:
        ConfigError: the name is unknown, the number of ranges differs from the action's size, a
            range is not above 0, pulse widths would leave the thrust table, or no vehicle has the
            joints.
    """
    if name not in (*KINDS, WHOLE_BODY):
        raise ConfigError(f"action = {name!r}: available: {', '.join((*KINDS, WHOLE_BODY))}")
    command: type | None
    make: MakeCommand
    if name == WHOLE_BODY:
        if joints is None:
            raise ConfigError(
                f"action = {name!r}: no vehicle of the fleet has joints; take 'twist'"
            )
        unit = "m/s, rad/s, in F; rad or m of each joint from the middle of its limits"
        default: tuple[float, ...] = (*TWIST_RANGE, *joints.half)
        command, make = BodyTwist, joints.make_command
    else:
        unit, default, command, make = KINDS[name]
    expected = default * thrusters if name == "pwm" else default
    chosen = expected if scale is None else tuple(scale)
    if len(chosen) != len(expected) or not all(0 < x < float("inf") for x in chosen):
        raise ConfigError(
            f"scale = {chosen}: action {name!r} has {len(expected)} numbers ({unit or 'none'}); "
            "give the value of 1 for each, above 0"
        )
    if name == "pwm" and max(chosen) > PWM_RANGE_US[0]:
        raise ConfigError(
            f"scale = {chosen}: action 'pwm' reaches {PWM_RANGE_US[0]:g} us from 1500 at most"
        )
    return ActionSpace(
        name=name, unit=unit, size=len(expected), range=chosen, command=command, make_command=make
    )


def check_actions(action: jax.Array | np.ndarray, shape: tuple[int, ...]) -> None:
    """Refuse actions of another shape, and numbers that are not finite where values are concrete.

    Raises:
        ConfigError: wrong shape, with the required one; or a number that is not finite, with its
            index.
    """
    if jnp.shape(action) != shape:
        raise ConfigError(
            f"action has the shape {list(jnp.shape(action))}: must be {list(shape)}, for "
            "[world, robot, number]"
        )
    if isinstance(action, jax.core.Tracer):
        return
    values = np.asarray(action)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        index = tuple(bad[0].tolist())
        raise ConfigError(
            f"action{list(index)} = {values[index]}: must be a finite number, as must all of "
            f"[world, robot, number]; {len(bad)} of {values.size} are not"
        )
