"""What a file may say about a robot's instruments; lengths in metres, angles in degrees.

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
    """Place, from the centre of mass, in F. Assumed: at the centre of mass."""
    gyro_noise_radps_per_rthz: NotNegative = 3.394e-4
    """White noise of the gyroscopes."""
    gyro_walk_radps2_per_rthz: NotNegative = 3.8785e-5
    """What drives the gyroscopes' wandering bias."""
    gyro_walk_time_s: Seconds = 1000.0
    """Memory of that bias."""
    gyro_turn_on_radps: NotNegative = 0.0087
    """Their constant bias, drawn once."""
    accel_noise_mps2_per_rthz: NotNegative = 0.004
    """White noise of the accelerometers."""
    accel_walk_mps3_per_rthz: NotNegative = 0.006
    """What drives the accelerometers' wandering bias."""
    accel_walk_time_s: Seconds = 300.0
    """Memory of that bias."""
    accel_turn_on_mps2: NotNegative = 0.196
    """Their constant bias, drawn once."""


class DepthConfig(FileModel):
    """A pressure sensor that gives depth below the surface."""

    fitted: bool = True
    """Whether the robot has one."""
    rate_hz: Rate = 10.0
    """Assumed; at most once in a control period, as with every rate here."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Place, from the centre of mass, in F."""
    noise_m: NotNegative = 0.01
    """Assumed: waves and turbulence, five steps of the resolution."""
    resolution_m: NotNegative = 0.002
    """Bar30: 2 mm."""
    surface_offset_m: NotNegative = 0.02
    """Assumed: zero of the depth scale, drawn once; 2 mbar of air pressure are 2 cm."""


class AhrsConfig(FileModel):
    """Attitude: level from gravity, heading from a compass. All assumed, of a small MEMS unit."""

    fitted: bool = True
    """Whether the robot has one."""
    rate_hz: Rate = 10.0
    """Of readings."""
    level_noise_deg: NotNegative = 0.3
    """White noise of roll and pitch."""
    heading_noise_deg: NotNegative = 1.0
    """White noise of the heading."""
    heading_bias_deg: NotNegative = 0.5
    """Declination and mounting, drawn once."""
    hard_iron: NotNegative = 0.01
    """Field of the robot itself along x and y, in parts of the horizontal field of the Earth, drawn
    once: 0.01 swings the heading by 0.6 degrees in a full turn."""


class DvlConfig(FileModel):
    """Velocity over the bottom. Defaults: Water Linked A50 where nothing else is said."""

    fitted: bool = True
    """Whether the robot has one."""
    rate_hz: Rate = 5.0
    """5 to 6 Hz between 1.5 and 14 m of altitude."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Place, from the centre of mass, in F."""
    noise_mps: NotNegative = 0.005
    """UUV Simulator."""
    noise_percent_of_speed: NotNegative = 0.3
    """Stonefish: 0.3 % of speed; the standard A50 is specified to 1 %, its performance edition to
    0.1 %."""
    min_altitude_m: NotNegative = 0.05
    """No bottom lock below ..."""
    max_altitude_m: PositiveLength = 50.0
    """... and above this altitude."""
    max_tilt_deg: Annotated[float, Field(gt=0, le=180)] = 35.0
    """Assumed: the beams lean out by 22.5 degrees."""
    dropout: Probability = 0.01
    """Assumed: probability of losing a reading though there is bottom lock."""


class UsblConfig(FileModel):
    """Position by sound from a transceiver that is somewhere in W. Not fitted by default."""

    fitted: bool = False
    """Whether the robot has one."""
    period_s: Seconds = 2.0
    """Assumed."""
    latency_s: NotNegative = 0.5
    """Assumed: way of the sound, processing, and the modem. From the moment that the position is
    of until the robot is told. Must be shorter than the period: one fix is under way at a time."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Place, from the centre of mass, in F."""
    transceiver_m: Vector = (0.0, 0.0, 0.0)
    """Its place, in W."""
    noise_m: NotNegative = 0.1
    """SeaTrac X150 gives ranges in steps of 0.1 m."""
    noise_percent_of_range: NotNegative = 1.75
    """Assumed: 1 degree of bearing. (SeaTrac X150 gives angles in steps of 0.1 degrees.)"""
    outlier: Probability = 0.05
    """Assumed: probability of a fix by an echo ..."""
    outlier_m: NotNegative = 10.0
    """... that is off by this (standard deviation). Assumed."""


class GpsConfig(FileModel):
    """Horizontal position while the antenna is out of the water. Not fitted by default."""

    fitted: bool = False
    """Whether the robot has one."""
    rate_hz: Rate = 1.0
    """Assumed."""
    offset_m: Vector = (0.0, 0.0, 0.0)
    """Place, from the centre of mass, in F."""
    noise_m: NotNegative = 0.5
    """Stonefish."""
    max_depth_m: Coordinate = 0.1
    """Depth of the antenna's place down to which it is taken to be dry. Assumed."""


class TruthNoiseConfig(FileModel):
    """White noise on the true state, for controllers that are fed with that. All assumed."""

    position_m: NotNegative = 0.02
    """Each axis of the position."""
    attitude_deg: NotNegative = 0.5
    """Each axis of the attitude."""
    velocity_mps: NotNegative = 0.01
    """Each axis of the velocity."""
    rate_radps: NotNegative = 0.005
    """Each axis of the rate of turn."""
    current_mps: NotNegative = 0.02
    """Each axis of the current."""


class SensorsConfig(FileModel):
    """The instruments of one robot."""

    noise: bool = True
    """False: readings are exact. They still come at their rates, after their latency, and only with
    bottom lock or at the surface; the filter goes on believing the figures below."""
    imu: ImuConfig = ImuConfig()
    depth: DepthConfig = DepthConfig()
    ahrs: AhrsConfig = AhrsConfig()
    dvl: DvlConfig = DvlConfig()
    usbl: UsblConfig = UsblConfig()
    gps: GpsConfig = GpsConfig()
    truth: TruthNoiseConfig = TruthNoiseConfig()
