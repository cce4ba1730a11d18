"""What goes into the sensor model and what comes out of it, for one robot at one control step."""

from dataclasses import dataclass

import jax


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Truth:
    """The true motion of a robot."""

    p: jax.Array
    """[3] centre of mass, m in W."""
    q: jax.Array
    """[4] attitude, F to W."""
    nu: jax.Array
    """[6] velocity over ground, m/s and rad/s, in F."""
    altitude_m: jax.Array
    """[] height above the bottom below."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ImuReading:
    """Gyroscopes and accelerometers; ``fresh`` is False at the first step, which has no past."""

    fresh: jax.Array
    """bool []"""
    rate_radps: jax.Array
    """[3] angular velocity now, in F."""
    mean_rate_radps: jax.Array
    """[3] rotation since the last step, divided by dt: q(t) = q(t - dt) exp(dt rate)."""
    specific_force_mps2: jax.Array
    """[3] mean over the same time, in F of mid-step: R_mid^T (a - g) at the IMU."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Reading:
    """All instruments of a robot. What is not fresh is zero (attitude too)."""

    imu: ImuReading
    depth_fresh: jax.Array
    """bool []"""
    depth_m: jax.Array
    """[] below the surface, positive down, of the sensor's place."""
    ahrs_fresh: jax.Array
    ahrs_q: jax.Array
    """[4] attitude, F to W."""
    dvl_fresh: jax.Array
    dvl_velocity_mps: jax.Array
    """[3] of the DVL's place over ground, in F."""
    usbl_pinged: jax.Array
    """bool [] the next fix will be of this moment."""
    usbl_fresh: jax.Array
    usbl_position_m: jax.Array
    """[3] of the transponder's place, in W, when it was pinged."""
    gps_fresh: jax.Array
    gps_position_m: jax.Array
    """[2] of the antenna's place, east and north."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SensorCarry:
    """Memory of the instruments of a robot."""

    started: jax.Array
    """bool [] False before the first step."""
    before_q: jax.Array
    """[4] attitude at the last step."""
    before_velocity: jax.Array
    """[3] of the IMU's place at the last step, m/s in W."""
    gyro_turn_on: jax.Array
    """[3] rad/s"""
    gyro_walk: jax.Array
    """[3] rad/s"""
    accel_turn_on: jax.Array
    """[3] m/s^2"""
    accel_walk: jax.Array
    """[3] m/s^2"""
    surface_m: jax.Array
    """[] what the depth is off by."""
    heading_bias_rad: jax.Array
    """[]"""
    hard_iron: jax.Array
    """[2] along x and y of F, in parts of the Earth's horizontal field."""
    usbl_fix_m: jax.Array
    """[3] the fix under way."""
