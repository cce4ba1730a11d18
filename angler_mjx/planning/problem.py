"""Input of a planner: one world, its team, and the information on moving obstacles and current.

All planners receive the same: arrays of NumPy on the host, of JAX on a device, where [world] leads
on all of them. Nothing else reaches a planner, so its paths depend on its problem and its settings
alone. Positions are in W (x east, y north, z up, metres, water surface at z = 0); the index of a
robot identifies it.
"""

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from angler_mjx._moved import renamed_attribute
from angler_mjx.robot.vehicles.link_hull import LinkCapsules
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.sim.information import CurrentInformation, Information, ObstacleInformation
from angler_mjx.world.rock.grid import Grid


@dataclass(frozen=True, kw_only=True)
class ProblemName:
    """Identity of a problem: equal names are equal problems on every machine."""

    scenario: str
    """Name of the scenario."""
    preset: str
    """Preset of its worlds."""
    seed: int
    world: int
    """Index of the world in all worlds of that seed."""
    digest: str
    """Digest, hexadecimal, of everything in the scenario that the problem depends on."""

    def __str__(self) -> str:
        return f"{self.scenario} ({self.preset}), seed {self.seed}, world {self.world}"


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TeamArms:
    """Links of the robots of one world and the postures from which they start.

    Those are the home postures before the flight, and the present ones when planning in flight. A
    robot without links has some without mass.
    """

    links: LinkParams
    """Links and joints, [R] leading."""
    capsules: LinkCapsules
    """Capsules of the links, [R] leading."""
    joint_position: jax.Array
    """[R, J] rad or m, in the order of ``Problem.joint_names``."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Team:
    """Robots of one world: starts, goals and capabilities."""

    start_m: jax.Array
    """[R, 3] start of each robot's centre of mass."""
    start_yaw_rad: jax.Array
    """[R] heading there, about z up, 0 = east."""
    goal_m: jax.Array
    """[R, 3]."""
    radius_m: jax.Array
    """[R] radius of the sphere about the centre of mass that holds the hull in every attitude, an
    arm in its posture at the start of the plan (see `TeamArms`)."""
    capsule_a_m: jax.Array
    """[R, c, 3] one end of the axis of each capsule of the hull, from the centre of mass, in the
    body frame (x forward, y left, z up), those of an arm in that posture behind the others;
    padding repeats a capsule."""
    capsule_b_m: jax.Array
    """[R, c, 3] the other end."""
    capsule_r_m: jax.Array
    """[R, c] radius of each capsule."""
    cruise_speed_mps: jax.Array
    """[R] speed limit along a path, m/s."""
    terminal_speed_mps: jax.Array
    """[R, 3] surge, sway, heave at full thrust in still water, m/s; 0 without thrust that way."""
    acceleration_mps2: jax.Array
    """[R, 3] surge, sway, heave from rest at full thrust, added mass included."""
    power_w: jax.Array
    """[R, 3, n] electrical power at constant speed through the water along surge, sway, heave
    alone, level and without net weight; at speeds of 0 to the terminal one in equal steps."""
    arms: TeamArms | None = None
    """Links and joints; None where no robot has any."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CargoProblem:
    """Body that the robots hold together; each keeps its pose in the body's frame.

    Goals of the team are those of robots that hold it, and so are starts where ``grip_m`` is None.
    """

    start_m: jax.Array
    """[3] its centre at the start, in W."""
    goal_m: jax.Array
    """[3] its centre at the goal."""
    turn_rad: jax.Array
    """[] its turn about z up from start to goal."""
    radius_m: jax.Array
    """[] radius of the sphere about its centre that holds it in every attitude."""
    axis_m: jax.Array
    """[3] from its centre to one end of the axis of a capsule that holds it, at the start, in W."""
    thickness_m: jax.Array
    """[] radius of that capsule."""
    grip_m: jax.Array | None = None
    """[R, 3] positions at which the robots take hold of it at the start, with their headings there,
    in W; None where they hold it already."""
    wait_s: jax.Array | None = None
    """[] time that their grippers may take to close; None likewise."""
    lift_m: jax.Array | None = None
    """[] height by which it is to be lifted straight up first; None likewise."""


_STATIC = {"static": True}
"""Metadata of fields that are compiled in."""


@dataclass(frozen=True, kw_only=True)
class ProblemSettings:
    """Numbers that all problems of a scenario share; hashable, static under jit."""

    horizon_s: float = field(metadata=_STATIC)
    """End of the flight [s], counted from the problem's start."""
    goal_tolerance_m: float = field(metadata=_STATIC)
    """Distance [m] of a robot's centre from its goal at which it has arrived."""
    information: Information = field(metadata=_STATIC)
    """Information levels; ``obstacles`` and ``current`` of a problem hold no more than them."""
    deadline_s: float = field(metadata=_STATIC)
    """Wall-clock time [s] that a planner has for one problem."""
    margin_m: float = field(default=0.1, metadata=_STATIC)
    """Distance [m] to keep beyond the radii, from rock, obstacles and other robots."""
    points: int = field(default=32, metadata=_STATIC)
    """Way-points that paths of a batch have; the limit of a path from the host."""
    max_cruise_speed_mps: float | None = field(default=None, metadata=_STATIC)
    """Cruise speed [m/s] of the fastest robot; None where it is not known at compile time."""
    cell_m: float | None = field(default=None, metadata=_STATIC)
    """Edge [m] of the grid's cells, as ``grid.cell_m``; None where it is not known at compile
    time."""
    water_or_obstacles_move: bool = field(default=False, metadata=_STATIC)
    """Whether the worlds of the scenario have currents or moving obstacles, known or not."""
    by_end_effector: bool = field(default=False, metadata=_STATIC)
    """Whether end effectors have to come to the goals, not centres of mass."""
    joint_names: tuple[str, ...] = field(default=(), metadata=_STATIC)
    """[J] names of the joints of `Team.arms`."""
    is_replan: bool = field(default=False, metadata=_STATIC)
    """Whether robots are under way: starts are then positions on their present paths."""

    def static_fields(self) -> dict[str, Any]:
        """Return these settings by name, as a `Problem` takes them."""
        return {item.name: getattr(self, item.name) for item in fields(ProblemSettings)}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Problem(ProblemSettings):
    """One world to plan for."""

    grid: Grid
    """Rock; its cube bounds the world."""
    floor_z_m: jax.Array
    """[] height of the sea floor, m."""
    team: Team
    obstacles: ObstacleInformation
    """Obstacles, as far as they are known."""
    current: CurrentInformation
    """Motion of the water, as far as it is known."""
    seed: jax.Array
    """uint32 [] seed of random draws: equal seeds and problems have equal plans."""
    cargo: CargoProblem | None = None
    """Body that the team carries, which is not among the obstacles; None where it carries none."""
    name: ProblemName | None = field(default=None, metadata=_STATIC)
    """Identity of the world; None in a batch."""

    if not TYPE_CHECKING:  # a checker would take every attribute for one

        def __getattr__(self, name: str) -> object:
            """Return a field by its name before 0.2, with a DeprecationWarning."""
            return renamed_attribute(self, name, {"knows": "information"})

    @property
    def robots(self) -> int:
        """Number of robots."""
        return int(np.shape(self.team.start_m)[-2])

    @property
    def lower_m(self) -> jax.Array:
        """Lower corner [3] of the cube that robots have to stay in; the floor cuts it off."""
        return self.grid.origin_m

    @property
    def upper_m(self) -> jax.Array:
        """Upper corner [3] of that cube."""
        cells = np.array(self.grid.occupied.shape[-3:], np.float32)
        return self.grid.origin_m + self.grid.cell_m[..., None] * cells

    def current_mps(self, p: ArrayLike, t: ArrayLike) -> np.ndarray:
        """Return the known velocity of the water at points and times.

        Args:
            p: [n, 3] points, m, W.
            t: [n] times, s.

        Returns:
            [n, 3] m/s, W, float32 of NumPy; zero where nothing is known.
        """
        return np.asarray(_current_velocity(self.current, jnp.asarray(p), jnp.asarray(t)))


@jax.jit
def _current_velocity(current: CurrentInformation, p: jax.Array, t: jax.Array) -> jax.Array:
    return jax.vmap(current.velocity)(p, t)
