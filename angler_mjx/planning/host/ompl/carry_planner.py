"""Planner carry_ompl: robots that hold a body, planned by OMPL on the manifold of the grasp.

Importing this needs no OMPL.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

from angler_mjx.errors import ConfigError, UnsupportedError, format_value
from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.planning.problem import Problem

PLANNERS = ("RRTConnect", "RRT", "RRTstar", "PRM", "KPIECE1", "BKPIECE1", "LBKPIECE1")
"""Planners of OMPL that search constrained spaces."""


@dataclass(frozen=True, kw_only=True)
class CarryOmplSettings:
    """Settings of the table [planner.carry_ompl]."""

    planner: str = "RRTConnect"
    """One of `PLANNERS`."""
    time_limit_s: float | None = None
    """Wall time of the search; the problem's deadline where that is less or this is left out."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: there is no such planner, or the time is not positive.
        """
        if self.planner not in PLANNERS:
            raise ValueError(
                f"planner = {format_value(self.planner)}: there is {', '.join(PLANNERS)}"
            )
        if self.time_limit_s is not None and not self.time_limit_s > 0.0:
            raise ValueError(f"time_limit_s = {self.time_limit_s:g}: must be above 0")


class OmplCarry:
    """Planner ``carry_ompl`` of scenarios, a `Planner`."""

    Settings = CarryOmplSettings
    joints = True

    def __init__(self, settings: CarryOmplSettings | None = None) -> None:
        """Keep the settings.

        Raises:
            UnsupportedError: OMPL or a library that it needs is not installed.
        """
        self._settings = CarryOmplSettings() if settings is None else settings
        try:
            self._carry = import_module("angler_mjx.planning.host.ompl.carry")
        except ModuleNotFoundError as error:
            raise UnsupportedError(
                f"planner carry_ompl needs {error.name}: pip install 'angler-mjx[plan]'"
            ) from error
        self.extras: dict[str, float] = {}
        """Of the last plan: ``search_s``."""

    def warm_up(self, problem: Problem) -> None:
        """Compile the functions that planning such problems needs."""
        self._carry.warm_up(problem)

    def plan(self, problem: Problem) -> Sequence[Path | NoPlan]:
        """Return a path of each robot; see `angler_mjx.planning.planner.Planner`.

        Raises:
            ConfigError: the robots carry nothing together.
        """
        if problem.cargo is None:
            raise ConfigError('planner carry_ompl: plans the task "carry" alone')
        if problem.cargo.grip_m is not None:
            raise ConfigError(
                "planner carry_ompl: knows no task.approach; take the planner carry, or robots "
                "that hold the body from the start"
            )
        limit_s = min(self._settings.time_limit_s or problem.deadline_s, problem.deadline_s)
        paths: list[Path | NoPlan]
        paths, self.extras = self._carry.plan_on_grasp(problem, self._settings.planner, limit_s)
        return paths
