"""Inputs and outputs of the sensor model, for one robot at one control step."""

from dataclasses import dataclass

import jax


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Truth:
    """True motion of a robot."""

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
    """bool [] whether the reading is of this step."""
    rate_radps: jax.Array
    """[3] angular velocity now, in F."""
    mean_rate_radps: jax.Array
    """[3] rotation since the last step, divided by dt: q(t) = q(t - dt) exp(dt rate)."""
    specific_force_mps2: jax.Array
    """[3] mean specific force over the same time, in F of mid-step: R_mid^T (a - g) at the IMU."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Reading:
    """Readings of all instruments of a robot; zero where not fresh (attitude too)."""

    imu: ImuReading
    depth_fresh: jax.Array
    """bool [] whether the depth is of this step."""
    depth_m: jax.Array
    """[] depth of the sensor below the surface, positive down."""
    ahrs_fresh: jax.Array
    ahrs_q: jax.Array
    """[4] attitude, F to W."""
    dvl_fresh: jax.Array
    dvl_velocity_mps: jax.Array
    """[3] velocity of the DVL over ground, in F."""
    usbl_pinged: jax.Array
    """bool [] whether the next fix will be of this moment."""
    usbl_fresh: jax.Array
    usbl_position_m: jax.Array
    """[3] position of the transponder, in W, when it was pinged."""
    gps_fresh: jax.Array
    gps_position_m: jax.Array
    """[2] position of the antenna, east and north."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SensorCarry:
    """Memory of the instruments of a robot."""

    started: jax.Array
    """bool [] whether a step was taken: False before the first."""
    before_q: jax.Array
    """[4] attitude at the last step."""
    before_velocity: jax.Array
    """[3] velocity of the IMU at the last step, m/s in W."""
    gyro_turn_on: jax.Array
    """[3] constant bias, rad/s."""
    gyro_walk: jax.Array
    """[3] wandering bias, rad/s."""
    accel_turn_on: jax.Array
    """[3] constant bias, m/s^2."""
    accel_walk: jax.Array
    """[3] wandering bias, m/s^2."""
    surface_m: jax.Array
    """[] offset of the depth scale."""
    heading_bias_rad: jax.Array
    """[] bias of the heading."""
    hard_iron: jax.Array
    """[2] along x and y of F, in parts of the Earth's horizontal field."""
    usbl_fix_m: jax.Array
    """[3] fix in flight."""
