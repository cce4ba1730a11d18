"""Underwater multi-robot simulation in batches, on JAX and MJX.

Public names are loaded at their first use, so that importing the package is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from angler_mjx import _moved
from angler_mjx._version import __version__ as __version__

if TYPE_CHECKING:
    from angler_mjx.planning.planner import BatchPlanner, NoPlan, Planner, joint_path, way_points
    from angler_mjx.planning.problem import Problem
    from angler_mjx.robot.control.commands import BodyTwist, BodyWrench, PoseTarget, ThrusterPwm
    from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
    from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
    from angler_mjx.robot.control.commands.trajectory import Trajectory
    from angler_mjx.runs.rollout import resume, rollout
    from angler_mjx.runs.session.batch_session import BatchSession
    from angler_mjx.runs.session.interface import Observation, Session
    from angler_mjx.runs.simulator.simulator import Simulator
    from angler_mjx.runs.storage.folder import Run
    from angler_mjx.scenario.scenario import Scenario, load_scenario
    from angler_mjx.sim.policy import Policy
    from angler_mjx.sim.state import Outcome

_moved.install()

__all__ = [
    "BatchPlanner",
    "BatchSession",
    "BodyTwist",
    "BodyWrench",
    "JointGoal",
    "JointPoint",
    "JointTrajectory",
    "NoPlan",
    "Observation",
    "Outcome",
    "Planner",
    "Policy",
    "PoseTarget",
    "Problem",
    "Run",
    "Scenario",
    "Session",
    "Simulator",
    "ThrusterPwm",
    "Trajectory",
    "joint_path",
    "load_scenario",
    "resume",
    "rollout",
    "way_points",
]

_HOME = {
    "BatchPlanner": "angler_mjx.planning.planner",
    "BatchSession": "angler_mjx.runs.session.batch_session",
    "BodyTwist": "angler_mjx.robot.control.commands",
    "BodyWrench": "angler_mjx.robot.control.commands",
    "JointGoal": "angler_mjx.robot.control.commands.joint_goal",
    "JointPoint": "angler_mjx.robot.control.commands.joint_goal",
    "JointTrajectory": "angler_mjx.robot.control.commands.joint_trajectory",
    "NoPlan": "angler_mjx.planning.planner",
    "Observation": "angler_mjx.runs.session.interface",
    "Outcome": "angler_mjx.sim.state",
    "Planner": "angler_mjx.planning.planner",
    "Policy": "angler_mjx.sim.policy",
    "PoseTarget": "angler_mjx.robot.control.commands",
    "Problem": "angler_mjx.planning.problem",
    "Run": "angler_mjx.runs.storage.folder",
    "Scenario": "angler_mjx.scenario.scenario",
    "Session": "angler_mjx.runs.session.interface",
    "Simulator": "angler_mjx.runs.simulator.simulator",
    "ThrusterPwm": "angler_mjx.robot.control.commands",
    "Trajectory": "angler_mjx.robot.control.commands.trajectory",
    "joint_path": "angler_mjx.planning.planner",
    "load_scenario": "angler_mjx.scenario.scenario",
    "resume": "angler_mjx.runs.rollout",
    "rollout": "angler_mjx.runs.rollout",
    "way_points": "angler_mjx.planning.planner",
}


def __dir__() -> list[str]:
    """Return the public names and those already loaded."""
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> object:
    """Load a public name from its module."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
