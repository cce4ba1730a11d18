"""Gains that make no sense are refused with their name and value."""

import dataclasses

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.laws import (
    aitsm,
    computed_torque,
    ismc,
    los,
    pid_pose,
    pid_velocity,
    tracking,
)
from angler_mjx.robot.control.laws.ardusub import law as ardusub

LAWS = [
    (pid_pose, pid_pose.PidPoseGains()),
    (pid_velocity, pid_velocity.PidVelocityGains()),
    (computed_torque, computed_torque.ComputedTorqueGains()),
    (tracking, tracking.TrackingGains()),
    (ismc, ismc.IsmcGains()),
    (aitsm, aitsm.AitsmGains()),
    (los, los.LosGains()),
    (ardusub, ardusub.ArduSubGains()),
]


@pytest.mark.parametrize(("law", "gains"), LAWS)
def test_defaults_pass_and_any_bad_number_is_named(law, gains):
    law.check(gains)
    for entry in dataclasses.fields(gains):
        for value in (-1.5, float("nan"), float("inf")):
            with pytest.raises(ConfigError, match=rf"{entry.name} = {value:g}"):
                law.check(dataclasses.replace(gains, **{entry.name: value}))


@pytest.mark.parametrize(
    ("law", "gains", "named"),
    [
        (ismc, ismc.IsmcGains(layer_mps=0.0), "layer_mps = 0"),
        (aitsm, aitsm.AitsmGains(layer=0.0), "layer = 0"),
        (aitsm, aitsm.AitsmGains(exponent=1.2), "exponent = 1.2"),
        (aitsm, aitsm.AitsmGains(exponent=1.0), "exponent = 1 must be less than 1"),
        (aitsm, aitsm.AitsmGains(sliding_most=0.1), "sliding_most = 0.1"),
        (los, los.LosGains(lookahead_m=0.0), "lookahead_m = 0"),
        (ardusub, ardusub.ArduSubGains(SERVO_TRIM=1000.0), "SERVO_TRIM = 1000"),
        (ardusub, ardusub.ArduSubGains(ANGLE_MAX=9500.0), "ANGLE_MAX = 9500"),
        (ardusub, ardusub.ArduSubGains(ANGLE_MAX=9000.0), "ANGLE_MAX = 9000 must be less"),
        (ardusub, ardusub.ArduSubGains(ATC_ANG_YAW_P=0.0), "ATC_ANG_YAW_P = 0"),
    ],
)
def test_what_divides_must_not_be_zero_and_pairs_must_fit(law, gains, named):
    with pytest.raises(ConfigError, match=named):
        law.check(gains)


@pytest.mark.parametrize(
    ("law", "gains"),
    [
        (aitsm, aitsm.AitsmGains(exponent=0.999)),
        (ardusub, ardusub.ArduSubGains(ANGLE_MAX=8999.5)),
    ],
)
def test_what_is_just_within_its_bound_passes(law, gains):
    law.check(gains)
