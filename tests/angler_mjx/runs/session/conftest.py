"""Two sessions, compiled once: one for each engine, over open water."""

import pytest

from angler_mjx.errors import RunError
from angler_mjx.robot.control.commands.joint_tolerance import JointTolerance, build_tolerances
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS
from angler_mjx.runs.session.batch_session import BatchSession

CALM = """
schema_version = 1
name = "calm"
seed = 3

[time]
horizon_s = 60.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"
"""


@pytest.fixture(scope="session")
def calm(tmp_path_factory):
    """A function: a scenario file of a Heavy and another robot."""

    def write(other):
        path = tmp_path_factory.mktemp("scene") / "calm.toml"
        path.write_text(CALM + f'\n[[fleet]]\nvehicle = "{other}"\n')
        return path

    return write


@pytest.fixture(scope="session")
def heavies(calm):
    """Two Heavies in the fused engine, which may leave a JointTrajectory by half a metre."""
    allowed = build_tolerances(
        VEHICLE_JOINTS,
        default_path=JointTolerance(position=0.5),
        default_goal=JointTolerance(position=0.15),
        default_goal_time_s=10.0,
    )
    return BatchSession(calm("bluerov2_heavy"), engine="fused", tolerances=allowed)


class Borrowed:
    """A session that is shared: closing it closes only this view of it."""

    def __init__(self, session):
        self._session, self._closed = session, False

    def __getattr__(self, name):
        return getattr(self._session, name)

    def step(self, commands=None):
        if self._closed:
            raise RunError("closed")
        return self._session.step(commands)

    def close(self):
        self._closed = True


@pytest.fixture(scope="session")
def borrowed():
    """The class of shared sessions; to be broken in many ways."""
    return Borrowed
