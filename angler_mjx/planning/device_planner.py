"""Planners on the device: made from their reference, checked, and called within traced programs.

The same function plans before the start, in the program that samples the worlds, and again in
flight, with a problem that starts now.
"""

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError, report_user_errors
from angler_mjx.planning.planner import BatchPlanner, Path
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.planning.register import PlannerReference, PlannerSpec
from angler_mjx.robot.control.commands.trajectory import Trajectory


@runtime_checkable
class SingleProblemPlanner(Protocol):
    """Planner with ``plan_one``, see `BatchPlanner`."""

    def plan_one(self, problem: Problem) -> Path:
        """Return paths [robot] of one world, traced."""
        ...


@dataclass(frozen=True, kw_only=True)
class DevicePlanner:
    """A planner with ``plan_batch``; hashable, static under jit."""

    reference: PlannerReference
    settings: tuple[tuple[str, object], ...]
    planner: BatchPlanner = field(compare=False, repr=False)
    """Made of the reference and the settings."""

    @property
    def plans_alone(self) -> bool:
        """Return whether the planner has ``plan_one``, see `BatchPlanner`."""
        return isinstance(self.planner, SingleProblemPlanner)

    def plan_batch(self, problems: Problem) -> Path:
        """Return paths [world, robot] of a batch, traced.

        Raises:
            ConfigError: the planner's code raises.
        """
        with report_user_errors(f"planner {self.reference.name}: plan_batch", self.reference.file):
            return self.planner.plan_batch(problems)

    def plan_one(self, problem: Problem) -> Path:
        """Return paths [robot] of one world, traced: by ``plan_one``, or as a batch of one.

        Raises:
            ConfigError: the planner's code raises.
        """
        if isinstance(self.planner, SingleProblemPlanner):
            name, file = self.reference.name, self.reference.file
            with report_user_errors(f"planner {name}: plan_one", file):
                return self.planner.plan_one(problem)
        paths = self.plan_batch(jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], problem))
        path: Path = jax.tree.map(lambda leaf: leaf[0], paths)
        return path

    def __call__(self, problem: Problem) -> Trajectory:
        """Return plans [robot] of one problem in flight, traced; see `Replanning.planner`.

        Raises:
            ConfigError: the planner's code raises, or returns no `Trajectory`.
        """
        plan = self.plan_one(problem)
        if not isinstance(plan, Trajectory):
            raise ConfigError(
                f"planner {self.reference.name}: gives {type(plan).__name__}; replanning takes a "
                "Trajectory"
            )
        return plan


def build_device_planner(spec: PlannerSpec, problem: ProblemSettings) -> DevicePlanner:
    """Make a planner of the device for problems with given settings.

    Args:
        spec: of a class with ``plan_batch``.
        problem: settings of the problems that it will plan.

    Raises:
        ConfigError: the planner refuses such problems, or its constructor raises.
    """
    reference = spec.reference
    with report_user_errors(f"planner {reference.name}: its constructor", reference.file):
        planner: BatchPlanner = spec.make()
    check = getattr(planner, "check_problem", None)
    if check is not None:
        with report_user_errors(f"planner {reference.name}: check_problem", reference.file):
            check(problem)
    return DevicePlanner(
        reference=reference, settings=tuple(sorted(spec.settings.items())), planner=planner
    )
