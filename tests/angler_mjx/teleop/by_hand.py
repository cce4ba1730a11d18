"""Robots and observations made by hand."""

import math

import numpy as np

from angler_mjx.robot.control.commands import BodyTwist, Estimate, PoseTarget, ThrusterPwm
from angler_mjx.runs.session.interface import Observation, RobotInfo, RobotStatus
from angler_mjx.sim.state import Outcome


def robot_info(i):
    return RobotInfo(
        name=f"robot_{i}",
        vehicle="bluerov2",
        parameter_set="blue_gazebo",
        radius_m=0.3,
        cruise_speed_mps=0.5,
        max_speed_mps=np.array([1.4, 0.7, 0.6]),
        max_turn_radps=0.9,
        thrusters=("a", "b"),
        accepts=(BodyTwist, PoseTarget),
    )


def turned(yaw=0.0, pitch=0.0):
    """Attitude q of a heading and then a pitch (nose down), rad."""
    a, b = 0.5 * yaw, 0.5 * pitch
    # Product of the quaternions (cos a, 0, 0, sin a) and (cos b, 0, sin b, 0).
    return np.array(
        [
            math.cos(a) * math.cos(b),
            -math.sin(a) * math.sin(b),
            math.cos(a) * math.sin(b),
            math.sin(a) * math.cos(b),
        ]
    )


def observed(time_s=0.0, p=None, q=None, nu=None, status=None, robots=3):
    """An observation of some robots; what is left out is at rest in the origin, level."""
    given = {
        "p": np.zeros((robots, 3)) if p is None else np.asarray(p, float),
        "q": np.tile(turned(), (robots, 1)) if q is None else np.asarray(q, float),
        "nu": np.zeros((robots, 6)) if nu is None else np.asarray(nu, float),
    }
    fine = RobotStatus(outcome=Outcome.RUNNING, command="plan")
    return Observation(
        time_s=time_s,
        estimate=Estimate(**given),
        covariance=None,
        truth=Estimate(**given),
        pwm=ThrusterPwm(pwm_us=np.full((robots, 2), 1500.0)),
        demanded=None,
        realised=None,
        clearance_m=np.full(robots, 1.25),
        obstacles=None,
        status=(fine,) * robots if status is None else tuple(status),
    )
