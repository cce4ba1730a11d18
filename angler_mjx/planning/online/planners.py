"""Planners of the device, as what plans anew while robots fly: from a problem to their plans."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError, raised_by
from angler_mjx.planning import grid
from angler_mjx.planning.current import planner as current
from angler_mjx.planning.current.planner import CurrentConfig
from angler_mjx.planning.path_search.robot import WayConfig
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

    config: WayConfig

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        team = problem.team
        return grid.plan(
            _environment(problem),
            team.radius_m,
            team.cruise_speed_mps,
            self.config,
            _moving(problem.obstacles),
        )


@dataclass(frozen=True, kw_only=True)
class PriorityReplanner:
    """The planner priority."""

    config: WayConfig
    budget: int

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        team = problem.team

        found = priority.plan(
            _alone(_environment(problem)),
            _alone(team.radius_m),
            _alone(team.cruise_speed_mps),
            _alone(problem.seed),
            self.config,
            self.budget,
            _alone(_moving(problem.obstacles)),
        )
        plan: Trajectory = jax.tree.map(lambda leaf: leaf[0], found)
        return plan


@dataclass(frozen=True, kw_only=True)
class CurrentReplanner:
    """The planner current."""

    config: CurrentConfig

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        found = current.plan(
            _alone(_environment(problem)),
            _alone(problem.team),
            _alone(problem.current),
            _alone(problem.obstacles),
            _alone(problem.seed),
            self.config,
        )
        plans: Trajectory = jax.tree.map(lambda leaf: leaf[0], found)
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
        with raised_by(f"planner {name}", file):
            given = _made(self).plan_batch(_alone(problem))
        if not isinstance(given, Trajectory):
            raise ConfigError(
                f"planner {name}: gives {type(given).__name__}; replanning takes a Trajectory"
            )
        plan: Trajectory = jax.tree.map(lambda leaf: leaf[0], given)
        return plan


@cache
def _made(anew: BatchReplanner) -> Any:
    return PlannerSpec(reference=anew.reference, settings=dict(anew.settings)).make()


def _alone[Leaves](tree: Leaves) -> Leaves:
    """A batch of one."""
    made: Leaves = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], tree)
    return made


def _moving(known: ObstacleInformation) -> ObstacleInformation | None:
    """Obstacles, where there are any."""
    return known if known.radius_m.shape[0] else None


def _environment(problem: Problem) -> Environment:
    """What the grid planner looks at in a world: rock, what stands, starts and goals."""
    team, zero = problem.team, jnp.zeros(())
    return Environment(
        grid=problem.grid,
        floor_z_m=problem.floor_z_m,
        obstacles=_standing(problem.obstacles),
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


def _standing(known: ObstacleInformation) -> Obstacles:
    """Obstacles that do not move; what only motion asks for is zero."""
    rows = known.radius_m.shape[0]
    one, six = jnp.zeros(rows), jnp.zeros((rows, 6))
    return Obstacles(
        kind=known.kind,
        size_m=known.half_size_m,
        motion=jnp.full(rows, STATIC, jnp.int32),
        path=jnp.zeros((rows, 8)),
        p0=known.p_m[:, 0],
        q0=known.q[:, 0],
        nu0=six,
        mass_kg=one,
        inertia_kgm2=jnp.zeros((rows, 3)),
        volume_m3=one,
        M_A=six,
        D_l=six,
        D_q=six,
        exists=known.exists & ~known.moves,
        kinds=(SPHERE, BOX, CAPSULE),
        motions=(STATIC,) if rows and known.some_stand else (),
    )
