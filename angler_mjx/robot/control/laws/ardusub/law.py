"""Surrogate of ArduSub's own control: from a pose target to PWM, gains named as its parameters.

Written from the documented shape of the firmware's loops, so that batches behave like it does:

- horizontal position: square-root P -> velocity PID (filters FLTE, FLTD; IMAX) -> acceleration ->
  share of ``ANGLE_MAX`` -> forward and lateral demand, without leaning;
- depth: square-root P -> velocity P -> acceleration PI -> throttle about neutral;
- attitude: level, heading shaped by ``ATC_INPUT_TC``, ``ATC_ACCEL_Y_MAX`` and ``ATC_SLEW_YAW`` with
  feed-forward of its rate; square-root P -> rate PID (FLTT, FLTE, FLTD; IMAX);
- mixer with the frame's factors and limits (`ardusub_mixer`), and PWM about the trim.

Not modelled: estimation (the estimate is taken as it is), the jerk-limited shaping of position
targets, pilot input, slew and notch filters, thrust curve and battery compensation (the firmware
has none for these frames by default), failsafes. Acceleration is the difference of the estimated
velocity. The firmware runs at 400 Hz; the surrogate flies alike with control periods of
10 and 50 ms.

The thrusters' dead band is not compensated, as there. So in still water the position swings
across it, by 12 cm from end to end for the BlueROV2 after a step of 2 m, which is what the real
firmware does too (docs/how_to/spotcheck.md); heading keeps an error of up to 4 degrees. In a
current that takes the thrusters out of their dead band, station is kept to centimetres.

The parameters are those of `ardusub_gains`.
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control.commands import Estimate, PoseTarget, ThrusterPwm
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.ardusub import mixer as ardusub_mixer
from angler_mjx.robot.control.laws.ardusub import pid as ardusub_pid
from angler_mjx.robot.control.laws.ardusub.gains import ArduSubGains, check
from angler_mjx.robot.control.laws.ardusub.pid import PidCarry, PidParameters, sqrt_controller
from angler_mjx.robot.control.laws.model import wrap_angle
from angler_mjx.robot.vehicles.params import VehicleParams

__all__ = ["ArduSubCarry", "ArduSubGains", "check", "reset", "step"]

_CDEG = math.pi / 18000
_CM = 0.01
_THROTTLE_PER_UNIT = 2e-3
"""Output of the acceleration loop to throttle: thousandths, and twice for -1 to 1."""
_MIN_BRAKE_RADPS2 = tuple(math.radians(x) for x in (40.0, 40.0, 10.0))
_MAX_BRAKE_RADPS2 = tuple(math.radians(x) for x in (720.0, 720.0, 120.0))
"""The attitude loop brakes with half of ATC_ACCEL_x_MAX, within these, rad/s^2."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ArduSubCarry:
    """Memory of the surrogate."""

    yaw_rad: jax.Array
    """[] shaped heading."""
    yaw_rate_radps: jax.Array
    """[] its rate."""
    velocity_mps: jax.Array
    """[3] of the step before, in W."""
    velocity_error_z: jax.Array
    """[] filtered, m/s."""
    plane: PidCarry
    """[2] velocity PIDs, in W."""
    depth: PidCarry
    """[] acceleration PID, cm/s^2."""
    rate: PidCarry
    """[3] rate PIDs, in F."""
    limited: jax.Array
    """bool [] the mixer had to cut the step before."""


def reset(estimate: Estimate) -> ArduSubCarry:
    """Memory of a robot that begins where it is, with the heading it has."""
    zero = jnp.zeros_like(estimate.p)
    return ArduSubCarry(
        yaw_rad=quaternion.yaw(estimate.q),
        yaw_rate_radps=zero[0],
        velocity_mps=quaternion.rotate(estimate.q, estimate.nu[:3]),
        velocity_error_z=zero[0],
        plane=ardusub_pid.reset(zero[:2]),
        depth=ardusub_pid.reset(zero[0]),
        rate=ardusub_pid.reset(zero),
        limited=zero[0] > 0,
    )


def step(
    gains: ArduSubGains,
    vehicle: VehicleParams,
    carry: ArduSubCarry,
    estimate: Estimate,
    command: PoseTarget,
    dt: float,
    density: float,
    gravity: float,
) -> tuple[ArduSubCarry, ThrusterPwm]:
    """One control step.

    Args:
        gains: the parameters.
        vehicle: of one robot; only its wrench matrix is read, for the frame's factors.
        carry: its memory.
        estimate: its state as known to the controller.
        command: the pose to be at.
        dt: control period, s.
        density: of the water, kg/m^3; not used.
        gravity: m/s^2.

    Returns:
        The new memory, and the thruster signals.
    """
    velocity = quaternion.rotate(estimate.q, estimate.nu[:3])
    plane, level = _control_plane(gains, carry, estimate, velocity, command, dt, gravity)
    depth, velocity_error_z, throttle = _control_depth(
        gains, carry, estimate, velocity, command, dt
    )
    yaw, yaw_rate = _shape_yaw(gains, carry, command.yaw_rad, dt)
    rate, turn = _control_attitude(gains, carry, estimate, yaw, yaw_rate, dt)
    factors = ardusub_mixer.frame_factors(vehicle.B)
    demand = jnp.concatenate([level, throttle[None], turn])
    output, limited = ardusub_mixer.mix_demand(factors, demand, gains.MOT_FV_CPLNG_K)
    room = jnp.where(
        output > 0, gains.MOT_PWM_MAX - gains.SERVO_TRIM, gains.SERVO_TRIM - gains.MOT_PWM_MIN
    )
    after = ArduSubCarry(
        yaw_rad=yaw,
        yaw_rate_radps=yaw_rate,
        velocity_mps=velocity,
        velocity_error_z=velocity_error_z,
        plane=plane,
        depth=depth,
        rate=rate,
        limited=limited,
    )
    return after, ThrusterPwm(pwm_us=gains.SERVO_TRIM + room * output)


def _control_plane(
    gains: ArduSubGains,
    carry: ArduSubCarry,
    estimate: Estimate,
    velocity: jax.Array,
    command: PoseTarget,
    dt: float,
    gravity: float,
) -> tuple[PidCarry, jax.Array]:
    """Horizontal position to the demand [2] forward and left."""
    error = command.position_m[:2] - estimate.p[:2]
    distance = jnp.sqrt(jnp.sum(error**2) + 1e-12)
    speed = sqrt_controller(distance, gains.PSC_POSXY_P, gains.WPNAV_ACCEL * _CM, dt)
    speed = jnp.minimum(speed, gains.WPNAV_SPEED * _CM)
    wanted = command.velocity_mps[:2] + error * (speed / distance)
    parameters = PidParameters(
        P=gains.PSC_VELXY_P,
        I=gains.PSC_VELXY_I,
        D=gains.PSC_VELXY_D,
        IMAX=gains.PSC_VELXY_IMAX * _CM,
        FLTT=0.0,
        FLTE=gains.PSC_VELXY_FLTE,
        FLTD=gains.PSC_VELXY_FLTD,
    )
    plane, acceleration = ardusub_pid.update_pid(
        parameters, carry.plane, wanted, velocity[:2], carry.limited, dt
    )
    heading = quaternion.yaw(estimate.q)
    cosine, sine = jnp.cos(heading), jnp.sin(heading)
    forward = cosine * acceleration[0] + sine * acceleration[1]
    left = cosine * acceleration[1] - sine * acceleration[0]
    upright = jnp.stack([forward, left, jnp.zeros_like(left)])
    return plane, ardusub_mixer.lean_demand(upright, gains.ANGLE_MAX * _CDEG, gravity)[:2]


def _control_depth(
    gains: ArduSubGains,
    carry: ArduSubCarry,
    estimate: Estimate,
    velocity: jax.Array,
    command: PoseTarget,
    dt: float,
) -> tuple[PidCarry, jax.Array, jax.Array]:
    """Depth to the throttle [], which the mixer holds; with the filtered error of velocity []."""
    error = command.position_m[2] - estimate.p[2]
    wanted = sqrt_controller(error, gains.PSC_POSZ_P, gains.WPNAV_ACCEL_Z * _CM, dt)
    wanted = jnp.clip(wanted, -gains.WPNAV_SPEED_DN * _CM, gains.WPNAV_SPEED_UP * _CM)
    slip = wanted + command.velocity_mps[2] - velocity[2]
    slip = ardusub_pid.low_pass(carry.velocity_error_z, slip, gains.PSC_VELZ_FLTE, dt)
    parameters = PidParameters(
        P=gains.PSC_ACCZ_P,
        I=gains.PSC_ACCZ_I,
        D=gains.PSC_ACCZ_D,
        IMAX=gains.PSC_ACCZ_IMAX,
        FLTT=0.0,
        FLTE=gains.PSC_ACCZ_FLTE,
        FLTD=0.0,
    )
    target = gains.PSC_VELZ_P * slip / _CM
    measured = (velocity[2] - carry.velocity_mps[2]) / (dt * _CM)
    depth, output = ardusub_pid.update_pid(
        parameters, carry.depth, target, measured, carry.limited, dt
    )
    return depth, slip, _THROTTLE_PER_UNIT * output


def _shape_yaw(
    gains: ArduSubGains, carry: ArduSubCarry, wanted: jax.Array, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Shaped heading [] and its rate []: limited in rate and in angular acceleration."""
    max_acceleration = gains.ATC_ACCEL_Y_MAX * _CDEG
    rate = sqrt_controller(
        wrap_angle(wanted - carry.yaw_rad), 1.0 / gains.ATC_INPUT_TC, max_acceleration, dt
    )
    slew = gains.ATC_SLEW_YAW * _CDEG
    rate = jnp.clip(rate, -slew, slew)
    rate = jnp.clip(
        rate,
        carry.yaw_rate_radps - max_acceleration * dt,
        carry.yaw_rate_radps + max_acceleration * dt,
    )
    return wrap_angle(carry.yaw_rad + rate * dt), rate


def _control_attitude(
    gains: ArduSubGains,
    carry: ArduSubCarry,
    estimate: Estimate,
    yaw: jax.Array,
    yaw_rate: jax.Array,
    dt: float,
) -> tuple[PidCarry, jax.Array]:
    """Attitude to the demand [3] roll, pitch, yaw."""
    like = estimate.p
    error = model.attitude_error(estimate.q, yaw)
    stiffness = jnp.array(
        [gains.ATC_ANG_RLL_P, gains.ATC_ANG_PIT_P, gains.ATC_ANG_YAW_P], like.dtype
    )
    max_acceleration = jnp.array(
        [gains.ATC_ACCEL_R_MAX, gains.ATC_ACCEL_P_MAX, gains.ATC_ACCEL_Y_MAX], like.dtype
    )
    low, high = (
        jnp.asarray(_MIN_BRAKE_RADPS2, like.dtype),
        jnp.asarray(_MAX_BRAKE_RADPS2, like.dtype),
    )
    brake = jnp.clip(0.5 * _CDEG * max_acceleration, low, high)
    wanted = sqrt_controller(error, stiffness, brake, dt)
    wanted = wanted + yaw_rate * quaternion.world_up(estimate.q)
    axes = ("RLL", "PIT", "YAW")
    parameters = PidParameters(
        **{
            name: jnp.array([getattr(gains, f"ATC_RAT_{axis}_{name}") for axis in axes], like.dtype)
            for name in ("P", "I", "D", "IMAX", "FLTT", "FLTE", "FLTD")
        }
    )
    return ardusub_pid.update_pid(
        parameters, carry.rate, wanted, estimate.nu[3:], carry.limited, dt
    )
