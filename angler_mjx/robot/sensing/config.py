"""File models of a robot's instruments; lengths in metres, angles in degrees.

Every default carries its source. *Assumed* means: no source, a round number of the usual size.
Standard deviations are of one axis. Off is ``fitted = false``.
"""

from typing import Annotated

from pydantic import Field

from angler_mjx.files import FileModel
from angler_mjx.quantities import Coordinate, PositiveLength

type Vector = tuple[Coordinate, Coordinate, Coordinate]
type Rate = Annotated[float, Field(ge=1e-3, le=1e6)]
type Seconds = Annotated[float, Field(ge=1e-3, le=1e6)]
type NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Probability = Annotated[float, Field(ge=0, lt=1)]


class ImuConfig(FileModel):
    """Gyroscopes and accelerometers, read once in every control period.

    White noise, bias at switching on (constant), and a bias that wanders (Gauss-Markov). Defaults:
    ADIS16448 as in UUV Simulator's IMU plugin.
    """

    offset_m: Vector = (0.0, 0.0, 0.0)
    """Position from the centre of mass, in F. Assumed: at the centre of mass."""
    gyro_noise_radps_per_rthz: NotNegative = 3.394e-4
    """White noise of the gyroscopes."""
    gyro_walk_radps2_per_rthz: NotNegative = 3.8785e-5
    """Driving noise of the gyroscopes' wandering bias."""
    gyro_walk_time_s: Seconds = 1000.0
    """Correlation time of that bias."""
    gyro_turn_on_radps: NotNegative = 0.0087
    """Constant bias of the gyroscopes, sampled once."""
    accel_noise_mps2_per_rthz: NotNegative = 0.004
    """White noise of the accelerometers."""
    accel_walk_mps3_per_rthz: NotNegative = 0.006
    """Driving noise of the accelerometers' wandering bias."""
    accel_walk_time_s: Seconds = 300.0
    """Correlation time of that bias."""
    accel_turn_on_mps2: NotNegative = 0.196
    """Constant bias of the accelerometers, sampled once."""


class DepthConfig(FileModel):
    """Pressure sensor for the depth below the surface."""

    fitted: bool = True
    """Whether the robot has a pressure sensor."""
    rate_hz: Rate = 10.0
    """Rate of readings. Assumed; at most once in a control period, as every rate of the
    instruments."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Position from the centre of mass, in F."""
    noise_m: NotNegative = 0.01
    """White noise. Assumed: waves and turbulence, five steps of the resolution."""
    resolution_m: NotNegative = 0.002
    """Step of the readings. Bar30: 2 mm."""
    surface_offset_m: NotNegative = 0.02
    """Zero error of the depth scale, sampled once. Assumed; 2 mbar of air pressure are 2 cm."""


class AhrsConfig(FileModel):
    """Attitude: level from gravity, heading from a compass. All assumed, of a small MEMS unit."""

    fitted: bool = True
    """Whether the robot has an AHRS."""
    rate_hz: Rate = 10.0
    """Rate of readings."""
    level_noise_deg: NotNegative = 0.3
    """White noise of roll and pitch."""
    heading_noise_deg: NotNegative = 1.0
    """White noise of the heading."""
    heading_bias_deg: NotNegative = 0.5
    """Declination and mounting error, sampled once."""
    hard_iron: NotNegative = 0.01
    """Field of the robot itself along x and y, in parts of the horizontal field of the Earth,
    sampled once: 0.01 swings the heading by 0.6 degrees in a full turn."""


class DvlConfig(FileModel):
    """Velocity over the bottom. Defaults: Water Linked A50 where no other source is stated."""

    fitted: bool = True
    """Whether the robot has a DVL."""
    rate_hz: Rate = 5.0
    """Rate of readings. 5 to 6 Hz between 1.5 and 14 m of altitude."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Position from the centre of mass, in F."""
    noise_mps: NotNegative = 0.005
    """Additive white noise. UUV Simulator."""
    noise_percent_of_speed: NotNegative = 0.3
    """Noise in proportion to the speed. Stonefish: 0.3 % of speed; the standard A50 is specified to
    1 %, its performance edition to 0.1 %."""
    min_altitude_m: NotNegative = 0.05
    """Altitude below which there is no bottom lock."""
    max_altitude_m: PositiveLength = 50.0
    """Altitude above which there is no bottom lock."""
    max_tilt_deg: Annotated[float, Field(gt=0, le=180)] = 35.0
    """Tilt above which there is no bottom lock. Assumed: the beams lean out by 22.5 degrees."""
    dropout: Probability = 0.01
    """Probability of losing a reading in spite of bottom lock. Assumed."""


class UsblConfig(FileModel):
    """Acoustic position by a transceiver at a fixed position in W. Not fitted by default."""

    fitted: bool = False
    """Whether the robot has a USBL transponder."""
    period_s: Seconds = 2.0
    """Time between fixes. Assumed."""
    latency_s: NotNegative = 0.5
    """Time from the measured position to its arrival at the robot: travel time of sound,
    processing, and the modem. Assumed. Must be shorter than the period: one fix is in flight at a
    time."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Position from the centre of mass, in F."""
    transceiver_m: Vector = (0.0, 0.0, 0.0)
    """Position of the transceiver, in W."""
    noise_m: NotNegative = 0.1
    """White noise. SeaTrac X150 gives ranges in steps of 0.1 m."""
    noise_percent_of_range: NotNegative = 1.75
    """Noise in proportion to the range. Assumed: 1 degree of bearing. (SeaTrac X150 gives angles in
    steps of 0.1 degrees.)"""
    outlier: Probability = 0.05
    """Probability of a fix by an echo. Assumed."""
    outlier_m: NotNegative = 10.0
    """Standard deviation of a fix by an echo. Assumed."""


class GpsConfig(FileModel):
    """Horizontal position while the antenna is out of the water. Not fitted by default."""

    fitted: bool = False
    """Whether the robot has a GPS receiver."""
    rate_hz: Rate = 1.0
    """Rate of readings. Assumed."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Position of the antenna from the centre of mass, in F."""
    noise_m: NotNegative = 0.5
    """White noise. Stonefish."""
    max_depth_m: Coordinate = 0.1
    """Depth of the antenna down to which it counts as dry. Assumed."""


class TruthNoiseConfig(FileModel):
    """White noise on the true state, for controllers that receive the true state. All assumed."""

    position_m: NotNegative = 0.02
    """Noise of each axis of the position."""
    attitude_deg: NotNegative = 0.5
    """Noise of each axis of the attitude."""
    velocity_mps: NotNegative = 0.01
    """Noise of each axis of the velocity."""
    rate_radps: NotNegative = 0.005
    """Noise of each axis of the rate of turn."""
    current_mps: NotNegative = 0.02
    """Noise of each axis of the current."""


class SensorsConfig(FileModel):
    """Instruments of one robot."""

    noise: bool = True
    """Whether readings are noisy. False: readings are exact. They still come at their rates, after
    their latency, and only with bottom lock or at the surface; the filter still assumes the figures
    below."""
    imu: ImuConfig = ImuConfig()
    depth: DepthConfig = DepthConfig()
    ahrs: AhrsConfig = AhrsConfig()
    dvl: DvlConfig = DvlConfig()
    usbl: UsblConfig = UsblConfig()
    gps: GpsConfig = GpsConfig()
    truth: TruthNoiseConfig = TruthNoiseConfig()
