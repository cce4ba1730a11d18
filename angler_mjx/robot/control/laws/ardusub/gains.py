"""Parameters of the ArduSub surrogate, by the firmware's names, in its units: cm, cdeg, Hz.

Defaults are what an ArduSub (4.6.0-dev, SITL) answers when it is asked for its parameters; all of
them were compared. ``SERVO_TRIM`` stands for the ``SERVOn_TRIM`` of its motors.
"""

from dataclasses import dataclass

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.laws.checks import check_gains


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ArduSubGains:
    """ArduSub's parameters, by its names and in its units, with its defaults for Sub."""

    PSC_POSXY_P: float = 1.0
    PSC_VELXY_P: float = 6.0
    """What Sub starts with; the position controller that it shares with others has 1 for it."""
    PSC_VELXY_I: float = 0.5
    PSC_VELXY_D: float = 0.0
    PSC_VELXY_IMAX: float = 1000.0
    """cm/s^2."""
    PSC_VELXY_FLTE: float = 5.0
    PSC_VELXY_FLTD: float = 5.0
    PSC_POSZ_P: float = 3.0
    PSC_VELZ_P: float = 8.0
    PSC_VELZ_FLTE: float = 5.0
    PSC_ACCZ_P: float = 0.5
    PSC_ACCZ_I: float = 0.1
    PSC_ACCZ_D: float = 0.0
    PSC_ACCZ_IMAX: float = 100.0
    """Thousandths of throttle."""
    PSC_ACCZ_FLTE: float = 20.0
    ATC_ANG_RLL_P: float = 6.0
    ATC_ANG_PIT_P: float = 6.0
    ATC_ANG_YAW_P: float = 6.0
    ATC_RAT_RLL_P: float = 0.135
    ATC_RAT_RLL_I: float = 0.09
    ATC_RAT_RLL_D: float = 0.0036
    ATC_RAT_RLL_IMAX: float = 0.444
    ATC_RAT_RLL_FLTT: float = 30.0
    ATC_RAT_RLL_FLTE: float = 0.0
    ATC_RAT_RLL_FLTD: float = 30.0
    ATC_RAT_PIT_P: float = 0.135
    ATC_RAT_PIT_I: float = 0.09
    ATC_RAT_PIT_D: float = 0.0036
    ATC_RAT_PIT_IMAX: float = 0.444
    ATC_RAT_PIT_FLTT: float = 30.0
    ATC_RAT_PIT_FLTE: float = 0.0
    ATC_RAT_PIT_FLTD: float = 30.0
    ATC_RAT_YAW_P: float = 0.18
    ATC_RAT_YAW_I: float = 0.018
    ATC_RAT_YAW_D: float = 0.0
    ATC_RAT_YAW_IMAX: float = 0.222
    ATC_RAT_YAW_FLTT: float = 5.0
    ATC_RAT_YAW_FLTE: float = 0.0
    ATC_RAT_YAW_FLTD: float = 5.0
    ATC_ACCEL_R_MAX: float = 110000.0
    """cdeg/s^2, as the two below."""
    ATC_ACCEL_P_MAX: float = 110000.0
    ATC_ACCEL_Y_MAX: float = 110000.0
    ATC_INPUT_TC: float = 0.15
    """s."""
    ATC_SLEW_YAW: float = 6000.0
    """cdeg/s."""
    ANGLE_MAX: float = 4500.0
    """cdeg."""
    WPNAV_SPEED: float = 100.0
    """cm/s; the firmware's own 1000 is out of reach of these vehicles."""
    WPNAV_ACCEL: float = 250.0
    """cm/s^2."""
    WPNAV_SPEED_UP: float = 250.0
    WPNAV_SPEED_DN: float = 150.0
    WPNAV_ACCEL_Z: float = 100.0
    MOT_FV_CPLNG_K: float = 1.0
    MOT_PWM_MIN: float = 1100.0
    """us."""
    MOT_PWM_MAX: float = 1900.0
    SERVO_TRIM: float = 1500.0
    """us, of all motors."""


def check(gains: ArduSubGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    divisors = [name for name in vars(gains) if name.startswith(("ATC_ANG", "ATC_ACCEL", "WPNAV"))]
    others = ["PSC_POSXY_P", "PSC_POSZ_P", "ATC_INPUT_TC", "ATC_SLEW_YAW", "ANGLE_MAX"]
    check_gains("ardusub", gains, positive=[*divisors, *others])
    if gains.ANGLE_MAX >= 9000:
        raise ConfigError(
            f"gains of ardusub: ANGLE_MAX = {gains.ANGLE_MAX:g} must be less than 9000"
        )
    if not gains.MOT_PWM_MIN < gains.SERVO_TRIM < gains.MOT_PWM_MAX:
        raise ConfigError(
            f"gains of ardusub: SERVO_TRIM = {gains.SERVO_TRIM:g} must lie between "
            f"MOT_PWM_MIN = {gains.MOT_PWM_MIN:g} and MOT_PWM_MAX = {gains.MOT_PWM_MAX:g}"
        )
