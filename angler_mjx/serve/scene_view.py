"""View of a session after a step: everything that its messages are made of, on the host."""

import time
from dataclasses import dataclass

import numpy as np

from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.runs.session.interface import Floats, Observation
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.teleop.opening import Drivable


@dataclass(frozen=True, kw_only=True)
class RobotFacts:
    """Facts of a robot that its session does not state."""

    battery_v: float
    sensors: SensorsConfig


@dataclass(frozen=True, kw_only=True)
class SceneView:
    """Scene after a step; [R] leads."""

    observation: Observation
    current_mps: Floats | None
    """[R, 3] water velocity in W, of the begin of the step; None before the first step."""
    energy_j: Floats
    """[R] energy of the thrusters since the reset."""
    wall_ns: int
    """Wall time of the observation, since 1970."""


def list_facts(scenario: Scenario) -> tuple[RobotFacts, ...]:
    """Return the facts of a scenario's robots, in order.

    Instruments of robots whose controllers use the truth are exact.
    """
    facts = []
    for entry in scenario.fleet:
        source, sensors = entry.state_source()
        sensors = SensorsConfig(noise=False) if source == "truth" else sensors
        facts += [RobotFacts(battery_v=float(entry.battery_v), sensors=sensors)] * entry.count
    return tuple(facts)


def view_scene(session: Drivable, observation: Observation) -> SceneView:
    """Return the view of a session.

    Args:
        session: session at the time of the observation.
        observation: its present observation.
    """
    internals = session.inside()
    sample = internals.sample
    current = None if sample is None else np.asarray(sample.current_mps)
    return SceneView(
        observation=observation,
        current_mps=None if current is None else current.reshape(-1, 3),
        energy_j=np.asarray(internals.state.tally.energy_j).reshape(-1),
        wall_ns=time.time_ns(),
    )
