"""What commands must look like before they enter a step: each type, each array, pulse widths."""

import re
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import command_checks
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.vehicles import library, params
from angler_mjx.sim.robot import thrust_and_power

LEAD, THRUSTERS, POINTS = (5, 2), 8, 7


def of_robots(*tail, like=float):
    return np.zeros((*LEAD, *tail), like)


def commands():
    """One of each type, as it should be."""
    pose = {name: of_robots(3) for name in ("position_m", "velocity_mps")}
    yaw = {name: of_robots() for name in ("yaw_rad", "yaw_rate_radps", "yaw_acceleration_radps2")}
    table = {name: of_robots(POINTS, 4) for name in ("position", "velocity", "acceleration")}
    return [
        Trajectory(
            time_s=of_robots(POINTS),
            position_m=of_robots(POINTS, 3),
            found=of_robots(like=bool),
        ),
        JointTrajectory(
            joints=("x", "y", "z", "yaw"),
            time_s=of_robots(POINTS),
            degree=of_robots(POINTS, like=np.int32),
            commanded=of_robots(4, like=bool),
            **table,
        ),
        TrackingTarget(**pose, acceleration_mps2=of_robots(3), **yaw),
        PoseTarget(**pose, yaw_rad=of_robots()),
        BodyTwist(nu=of_robots(6)),
        BodyWrench(tau=of_robots(6)),
        ThrusterPwm(pwm_us=of_robots(THRUSTERS)),
    ]


ARRAYS = [
    (command, field.name)
    for command in commands()
    for field in fields(command)
    if isinstance(getattr(command, field.name), np.ndarray)
]


@pytest.mark.parametrize(
    ("command", "name"), ARRAYS, ids=[f"{type(c).__name__}.{name}" for c, name in ARRAYS]
)
def test_every_array_of_every_command_is_looked_at(command, name):
    command_checks.check_arrays(command, LEAD, THRUSTERS)
    value = getattr(command, name)
    for bad, said in (
        (np.zeros((*value.shape, 2)), "has the shape"),
        (value[:, :1], "has the shape"),
        (value[..., 0], "has the shape"),
        (value.astype(complex), "complex128: must be an array of real numbers"),
        (value.tolist(), "list: must be an array of real numbers"),
        (None, "NoneType: must be an array of real numbers"),
    ):
        with pytest.raises(ConfigError, match=f"command {type(command).__name__}: .*{said}"):
            command_checks.check_arrays(replace(command, **{name: bad}), LEAD, THRUSTERS)


def test_a_path_of_one_point_is_none():
    path = commands()[0]
    short = replace(path, time_s=path.time_s[..., :1], position_m=path.position_m[..., :1, :])
    with pytest.raises(ConfigError, match=r"time_s has the shape \[5, 2, 1\]: must be \[5, 2, 2\]"):
        command_checks.check_arrays(short, LEAD, THRUSTERS)


@pytest.mark.parametrize("value", [1e9, np.nan, np.inf, 1099.0, -1500.0])
def test_pulse_widths_that_the_host_holds_are_refused_beyond_the_thrust_table(value):
    pulses = np.full((*LEAD, THRUSTERS), 1900.0)
    command_checks.check_pulses(ThrusterPwm(pwm_us=pulses))
    pulses[3, 1, 5] = value
    said = re.escape(f"world 3, robot 1, thruster 5 is {value:g} us")
    with pytest.raises(ConfigError, match=said):
        command_checks.check_pulses(ThrusterPwm(pwm_us=pulses))
    # A device's are not waited for; beyond the table its ends hold, and NaN stays NaN.
    command_checks.check_pulses(ThrusterPwm(pwm_us=jnp.asarray(pulses)))
    vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    thrust, _ = thrust_and_power(vehicle, ThrusterPwm(pwm_us=jnp.asarray(pulses[3, 1])))
    ends = {True: vehicle.thrust_n[-1], False: vehicle.thrust_n[0]}
    expected = np.nan if np.isnan(value) else ends[value > 1500.0]
    np.testing.assert_allclose(thrust[5], expected)


@pytest.mark.parametrize("name", ["which", "fresh"])
def test_a_mixed_command_chooses_for_every_robot(name):
    choice = {"which": of_robots(like=np.int32), "fresh": of_robots(like=np.int32)}
    command_checks.check_choice(MixedCommand(commands=(), **choice), LEAD)
    with pytest.raises(ConfigError, match=rf"Mixed: {name} has the shape \[5\]: must be \[5, 2\]"):
        command_checks.check_choice(
            MixedCommand(commands=(), **{**choice, name: np.zeros(5)}), LEAD
        )
