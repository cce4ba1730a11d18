"""Underwater multi-robot simulation in batches, on JAX and MJX.

The public names are loaded when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from angler_mjx.control.commands import ThrusterPwm
    from angler_mjx.runs.folder import Run
    from angler_mjx.runs.rollout import resume, rollout
    from angler_mjx.runs.scenario import Scenario, load_scenario
    from angler_mjx.runs.simulator import Simulator
    from angler_mjx.sim.state import Outcome

__version__ = "0.1.0"

__all__ = [
    "Outcome",
    "Run",
    "Scenario",
    "Simulator",
    "ThrusterPwm",
    "load_scenario",
    "resume",
    "rollout",
]

_HOME = {
    "Outcome": "angler_mjx.sim.state",
    "Run": "angler_mjx.runs.folder",
    "Scenario": "angler_mjx.runs.scenario",
    "Simulator": "angler_mjx.runs.simulator",
    "ThrusterPwm": "angler_mjx.control.commands",
    "load_scenario": "angler_mjx.runs.scenario",
    "resume": "angler_mjx.runs.rollout",
    "rollout": "angler_mjx.runs.rollout",
}


def __getattr__(name: str) -> Any:
    """Load a public name from where it is defined."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
