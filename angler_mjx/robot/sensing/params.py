"""Sensor parameters of one robot: arrays in SI units, compiled from a config."""

import math
from dataclasses import dataclass, field, fields, replace
from statistics import NormalDist
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.sensing.config import ImuConfig, SensorsConfig, UsblConfig

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ImuParams:
    """Parameters of the IMU; standard deviations are of a mean over one control period."""

    offset_m: jax.Array
    """[3] position from the centre of mass, in F."""
    gyro_std: jax.Array
    """[] rad/s: density / sqrt(dt)."""
    gyro_walk_std: jax.Array
    """[] rad/s, increment of the wandering bias in one step."""
    gyro_walk_kept: jax.Array
    """[] 1, fraction of the wandering bias that remains after one step: exp(-dt / tau)."""
    gyro_turn_on_std: jax.Array
    """[] rad/s, constant bias."""
    accel_std: jax.Array
    """[] m/s^2; this and the following as for the gyroscopes."""
    accel_walk_std: jax.Array
    accel_walk_kept: jax.Array
    accel_turn_on_std: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DepthParams:
    """Parameters of the pressure sensor."""

    every: jax.Array
    """int32 [] steps from reading to reading, 0 = not fitted; the same in the classes below."""
    offset_m: jax.Array
    std_m: jax.Array
    resolution_m: jax.Array
    surface_std_m: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AhrsParams:
    """Parameters of compass and level."""

    every: jax.Array
    level_std_rad: jax.Array
    heading_std_rad: jax.Array
    heading_bias_std_rad: jax.Array
    hard_iron_std: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DvlParams:
    """Parameters of the Doppler log."""

    every: jax.Array
    offset_m: jax.Array
    std_mps: jax.Array
    std_per_speed: jax.Array
    min_altitude_m: jax.Array
    max_altitude_m: jax.Array
    min_cos_tilt: jax.Array
    dropout_below: jax.Array
    """[] threshold of a standard normal number, below which a reading is lost."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class UsblParams:
    """Parameters of the acoustic positioning."""

    every: jax.Array
    latency: jax.Array
    """int32 [] steps, less than ``every``."""
    latency_s: jax.Array
    offset_m: jax.Array
    transceiver_m: jax.Array
    std_m: jax.Array
    std_per_range: jax.Array
    outlier_below: jax.Array
    outlier_std_m: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GpsParams:
    """Parameters of the satellite receiver."""

    every: jax.Array
    offset_m: jax.Array
    std_m: jax.Array
    max_depth_m: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TruthNoiseParams:
    """Parameters of the noise on the true state."""

    position_std_m: jax.Array
    attitude_std_rad: jax.Array
    velocity_std_mps: jax.Array
    rate_std_radps: jax.Array
    current_std_mps: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SensorParams:
    """Instruments of one robot."""

    imu: ImuParams
    depth: DepthParams
    ahrs: AhrsParams
    dvl: DvlParams
    usbl: UsblParams
    gps: GpsParams
    truth: TruthNoiseParams
    dt_s: jax.Array
    """[] control period."""
    gravity_mps2: jax.Array
    """[] gravity."""
    noise: bool = field(metadata={"static": True})
    """Whether readings are noisy. False: readings are exact. They still come at their rates, after
    their latency, and only with bottom lock or at the surface. A filter still assumes the figures
    above."""


def scale_noise(params: SensorParams, factor: jax.Array) -> SensorParams:
    """Return the same instruments with ``factor`` [] times the noise.

    Standard deviations are scaled, those of biases too; rates, dropouts, the probability of echoes
    and the steps of readings do not change.
    """

    def scaled[T: "DataclassInstance"](part: T) -> T:
        names = [entry.name for entry in fields(part) if "std" in entry.name]
        return replace(part, **{name: factor * getattr(part, name) for name in names})

    parts = ("imu", "depth", "ahrs", "dvl", "usbl", "gps", "truth")
    return replace(params, **{name: scaled(getattr(params, name)) for name in parts})


def check_sensors(config: SensorsConfig, control_dt_s: float) -> None:
    """Refuse impossible instruments (host side).

    Args:
        config: instruments of the robot.
        control_dt_s: control period, s.

    Raises:
        ConfigError: a USBL whose latency is not shorter than its period, or a DVL without a range
            between its altitudes.
    """
    dvl, usbl = config.dvl, config.usbl
    if not dvl.min_altitude_m < dvl.max_altitude_m:
        raise ConfigError(
            f"sensors.dvl.min_altitude_m = {dvl.min_altitude_m}: "
            f"must be below max_altitude_m = {dvl.max_altitude_m}"
        )
    every = max(1, round(usbl.period_s / control_dt_s))
    if usbl.fitted and round(usbl.latency_s / control_dt_s) >= every:
        raise ConfigError(
            f"sensors.usbl.latency_s = {usbl.latency_s}: must be shorter than "
            f"period_s = {usbl.period_s} by at least one control period of {control_dt_s} s; "
            "one fix is under way at a time"
        )


def build_sensors(config: SensorsConfig, control_dt_s: float, gravity_mps2: float) -> SensorParams:
    """Compile the instruments of one robot.

    Rates become whole control periods: the nearest, at least one.

    Args:
        config: instruments of the robot.
        control_dt_s: control period, s.
        gravity_mps2: m/s^2.

    Raises:
        ConfigError: as `check_sensors`.
    """
    check_sensors(config, control_dt_s)
    depth, ahrs, dvl, gps, truth = config.depth, config.ahrs, config.dvl, config.gps, config.truth

    def every(fitted: bool, rate_hz: float) -> jax.Array:
        return _period_steps(fitted, 1.0 / rate_hz, control_dt_s)

    return SensorParams(
        imu=_build_imu(config.imu, control_dt_s),
        depth=DepthParams(
            every=every(depth.fitted, depth.rate_hz),
            offset_m=_vector_array(depth.offset_m),
            std_m=_scalar_array(depth.noise_m),
            resolution_m=_scalar_array(depth.resolution_m),
            surface_std_m=_scalar_array(depth.surface_offset_m),
        ),
        ahrs=AhrsParams(
            every=every(ahrs.fitted, ahrs.rate_hz),
            level_std_rad=_scalar_array(math.radians(ahrs.level_noise_deg)),
            heading_std_rad=_scalar_array(math.radians(ahrs.heading_noise_deg)),
            heading_bias_std_rad=_scalar_array(math.radians(ahrs.heading_bias_deg)),
            hard_iron_std=_scalar_array(ahrs.hard_iron),
        ),
        dvl=DvlParams(
            every=every(dvl.fitted, dvl.rate_hz),
            offset_m=_vector_array(dvl.offset_m),
            std_mps=_scalar_array(dvl.noise_mps),
            std_per_speed=_scalar_array(0.01 * dvl.noise_percent_of_speed),
            min_altitude_m=_scalar_array(dvl.min_altitude_m),
            max_altitude_m=_scalar_array(dvl.max_altitude_m),
            min_cos_tilt=_scalar_array(math.cos(math.radians(dvl.max_tilt_deg))),
            dropout_below=_normal_quantile(dvl.dropout),
        ),
        usbl=_build_usbl(config.usbl, control_dt_s),
        gps=GpsParams(
            every=every(gps.fitted, gps.rate_hz),
            offset_m=_vector_array(gps.offset_m),
            std_m=_scalar_array(gps.noise_m),
            max_depth_m=_scalar_array(gps.max_depth_m),
        ),
        truth=TruthNoiseParams(
            position_std_m=_scalar_array(truth.position_m),
            attitude_std_rad=_scalar_array(math.radians(truth.attitude_deg)),
            velocity_std_mps=_scalar_array(truth.velocity_mps),
            rate_std_radps=_scalar_array(truth.rate_radps),
            current_std_mps=_scalar_array(truth.current_mps),
        ),
        dt_s=_scalar_array(control_dt_s),
        gravity_mps2=_scalar_array(gravity_mps2),
        noise=config.noise,
    )


def _build_imu(config: ImuConfig, dt: float) -> ImuParams:
    gyro_kept, gyro_walk = _random_walk_step(
        config.gyro_walk_radps2_per_rthz, config.gyro_walk_time_s, dt
    )
    accel_kept, accel_walk = _random_walk_step(
        config.accel_walk_mps3_per_rthz, config.accel_walk_time_s, dt
    )
    return ImuParams(
        offset_m=_vector_array(config.offset_m),
        gyro_std=_scalar_array(config.gyro_noise_radps_per_rthz / math.sqrt(dt)),
        gyro_walk_std=_scalar_array(gyro_walk),
        gyro_walk_kept=_scalar_array(gyro_kept),
        gyro_turn_on_std=_scalar_array(config.gyro_turn_on_radps),
        accel_std=_scalar_array(config.accel_noise_mps2_per_rthz / math.sqrt(dt)),
        accel_walk_std=_scalar_array(accel_walk),
        accel_walk_kept=_scalar_array(accel_kept),
        accel_turn_on_std=_scalar_array(config.accel_turn_on_mps2),
    )


def _random_walk_step(density: float, tau: float, dt: float) -> tuple[float, float]:
    """Return decay and increment of one step of db/dt = -b / tau + density w(t), exactly."""
    added = density * math.sqrt(-0.5 * tau * math.expm1(-2 * dt / tau))
    return math.exp(-dt / tau), added


def _build_usbl(config: UsblConfig, dt: float) -> UsblParams:
    latency = round(config.latency_s / dt)
    return UsblParams(
        every=_period_steps(config.fitted, config.period_s, dt),
        latency=jnp.asarray(latency, jnp.int32),
        latency_s=_scalar_array(latency * dt),
        offset_m=_vector_array(config.offset_m),
        transceiver_m=_vector_array(config.transceiver_m),
        std_m=_scalar_array(config.noise_m),
        std_per_range=_scalar_array(0.01 * config.noise_percent_of_range),
        outlier_below=_normal_quantile(config.outlier),
        outlier_std_m=_scalar_array(config.outlier_m),
    )


def _period_steps(fitted: bool, period_s: float, dt: float) -> jax.Array:
    return jnp.asarray(max(1, round(period_s / dt)) if fitted else 0, jnp.int32)


def _normal_quantile(probability: float) -> jax.Array:
    """Return the quantile of the standard normal distribution for a probability."""
    return _scalar_array(NormalDist().inv_cdf(probability) if probability > 0 else -math.inf)


def _scalar_array(value: float) -> jax.Array:
    return jnp.asarray(value, float)


def _vector_array(value: tuple[float, float, float]) -> jax.Array:
    return jnp.asarray(value, float)
