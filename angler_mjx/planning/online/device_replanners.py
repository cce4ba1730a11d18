"""Planners of the device, as what plans anew while robots fly: from a problem to their plans."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError, report_user_errors
from angler_mjx.planning import grid
from angler_mjx.planning.current import planner as current
from angler_mjx.planning.current.planner import CurrentConfig
from angler_mjx.planning.path_search.robot_search import PathSearchConfig
from angler_mjx.planning.priority import planner as priority
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerReference, PlannerSpec
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, STATIC, Obstacles


@dataclass(frozen=True, kw_only=True)
class GridReplanner:
    """The grid planner."""

    config: PathSearchConfig

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        team = problem.team
        return grid.plan_grid(
            _build_environment(problem),
            team.radius_m,
            team.cruise_speed_mps,
            self.config,
            _moving_or_none(problem.obstacles),
        )


@dataclass(frozen=True, kw_only=True)
class PriorityReplanner:
    """The planner priority."""

    config: PathSearchConfig
    budget: int

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        team = problem.team

        batch_plans = priority.plan_teams(
            _as_batch(_build_environment(problem)),
            _as_batch(team.radius_m),
            _as_batch(team.cruise_speed_mps),
            _as_batch(problem.seed),
            self.config,
            self.budget,
            _as_batch(_moving_or_none(problem.obstacles)),
        )
        plan: Trajectory = jax.tree.map(lambda leaf: leaf[0], batch_plans)
        return plan


@dataclass(frozen=True, kw_only=True)
class CurrentReplanner:
    """The planner current."""

    config: CurrentConfig

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        batch_plans = current.plan_paths(
            _as_batch(_build_environment(problem)),
            _as_batch(problem.team),
            _as_batch(problem.current),
            _as_batch(problem.obstacles),
            _as_batch(problem.seed),
            self.config,
        )
        plans: Trajectory = jax.tree.map(lambda leaf: leaf[0], batch_plans)
        return plans


@dataclass(frozen=True, kw_only=True)
class BatchReplanner:
    """A planner with ``plan_batch``, made once in a process."""

    reference: PlannerReference
    settings: tuple[tuple[str, Any], ...]

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem.

        Raises:
            ConfigError: it gives no `Trajectory`.
        """
        name, file = self.reference.name, self.reference.file
        with report_user_errors(f"planner {name}", file):
            batch_plans = _make_planner(self).plan_batch(_as_batch(problem))
        if not isinstance(batch_plans, Trajectory):
            raise ConfigError(
                f"planner {name}: gives {type(batch_plans).__name__}; replanning takes a Trajectory"
            )
        plan: Trajectory = jax.tree.map(lambda leaf: leaf[0], batch_plans)
        return plan


@cache
def _make_planner(replanner: BatchReplanner) -> Any:
    return PlannerSpec(reference=replanner.reference, settings=dict(replanner.settings)).make()


def _as_batch[Leaves](tree: Leaves) -> Leaves:
    """A batch of one."""
    batch: Leaves = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], tree)
    return batch


def _moving_or_none(information: ObstacleInformation) -> ObstacleInformation | None:
    """Obstacles, where there are any."""
    return information if information.radius_m.shape[0] else None


def _build_environment(problem: Problem) -> Environment:
    """What the grid planner looks at in a world: rock, what stands, starts and goals."""
    team, zero = problem.team, jnp.zeros(())
    return Environment(
        grid=problem.grid,
        floor_z_m=problem.floor_z_m,
        obstacles=_static_obstacles(problem.obstacles),
        current=(),
        start_m=team.start_m,
        start_yaw_rad=team.start_yaw_rad,
        goal_m=team.goal_m,
        density=zero,
        path_ratio=jnp.ones_like(team.start_yaw_rad),
        line_free=jnp.zeros_like(team.start_yaw_rad, bool),
        redraws=jnp.zeros((), jnp.int32),
        valid=jnp.ones((), bool),
    )


def _static_obstacles(information: ObstacleInformation) -> Obstacles:
    """Obstacles that do not move; what only motion asks for is zero."""
    rows = information.radius_m.shape[0]
    zeros, zeros_by_axis = jnp.zeros(rows), jnp.zeros((rows, 6))
    return Obstacles(
        kind=information.kind,
        size_m=information.half_size_m,
        motion=jnp.full(rows, STATIC, jnp.int32),
        path=jnp.zeros((rows, 8)),
        p0=information.p_m[:, 0],
        q0=information.q[:, 0],
        nu0=zeros_by_axis,
        mass_kg=zeros,
        inertia_kgm2=jnp.zeros((rows, 3)),
        volume_m3=zeros,
        M_A=zeros_by_axis,
        D_l=zeros_by_axis,
        D_q=zeros_by_axis,
        exists=information.exists & ~information.moves,
        kinds=(SPHERE, BOX, CAPSULE),
        motions=(STATIC,) if rows and information.some_stand else (),
    )
