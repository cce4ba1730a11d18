"""What a planner is asked: one world, the team in it, and what may be known of what moves.

The same for every planner, whatever it is written in: arrays of NumPy on the host, of JAX on a
device, where [world] leads on all of them. All is in W (x east, y north, z up, metres, water
surface at z = 0); robots are told apart by their number.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx._moved import renamed_attribute
from angler_mjx.sim.information import CurrentInformation, Information, ObstacleInformation
from angler_mjx.world.grid import Grid


@dataclass(frozen=True, kw_only=True)
class ProblemName:
    """Which problem it is: the same name is the same problem, wherever it is drawn."""

    scenario: str
    """Name of the scenario."""
    preset: str
    """Of its worlds."""
    seed: int
    world: int
    """Index of the world in all worlds of that seed."""
    digest: str
    """Hexadecimal, of everything in the scenario that the problem is drawn from."""

    def __str__(self) -> str:
        return f"{self.scenario} ({self.preset}), seed {self.seed}, world {self.world}"


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Team:
    """The robots of one world: where they are, where they go, and what they can do."""

    start_m: Any
    """[R, 3] start of each robot's centre of mass."""
    start_yaw_rad: Any
    """[R] heading there, about z up, 0 = east."""
    goal_m: Any
    """[R, 3]."""
    radius_m: Any
    """[R] sphere about the centre of mass that holds the hull, however it turns."""
    capsule_a_m: Any
    """[R, c, 3] one end of the axis of each capsule of the hull, from the centre of mass, in the
    body frame (x forward, y left, z up); padding repeats the last capsule."""
    capsule_b_m: Any
    """[R, c, 3] the other end."""
    capsule_r_m: Any
    """[R, c] radius of each capsule."""
    cruise_speed_mps: Any
    """[R] what the robot is to keep to along its path; no plan may be faster."""
    terminal_speed_mps: Any
    """[R, 3] surge, sway, heave at full thrust in still water; 0 for a way that it cannot push."""
    acceleration_mps2: Any
    """[R, 3] surge, sway, heave from rest at full thrust, added mass included."""
    power_w: Any
    """[R, 3, n] electrical power at constant speed through the water along surge, sway, heave
    alone, level and without net weight; at speeds of 0 to the terminal one in equal steps."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Problem:
    """One world to be planned for."""

    grid: Grid
    """Rock; what is outside its cube is out of bounds."""
    floor_z_m: Any
    """[] height of the sea floor."""
    team: Team
    obstacles: ObstacleInformation
    """Bodies that are not cells, as far as they are known."""
    current: CurrentInformation
    """The water's motion, as far as it is known."""
    seed: Any
    """uint32 [] for what a planner draws: the same seed and problem, the same plan."""
    horizon_s: float = field(metadata={"static": True})
    """Nothing is flown after it."""
    goal_tolerance_m: float = field(metadata={"static": True})
    """A robot has arrived when its centre is this near to its goal."""
    information: Information = field(metadata={"static": True})
    """What may be known; ``obstacles`` and ``current`` hold no more than that."""
    deadline_s: float = field(metadata={"static": True})
    """Wall-clock time that a planner has for this problem."""
    name: ProblemName | None = field(default=None, metadata={"static": True})
    """None where many problems lie in one batch."""

    if not TYPE_CHECKING:  # a checker would take every attribute for one

        def __getattr__(self, name: str) -> Any:
            """Return a field by its name before 0.2, with a DeprecationWarning."""
            return renamed_attribute(self, name, {"knows": "information"})

    @property
    def robots(self) -> int:
        """Number of robots."""
        return int(np.shape(self.team.start_m)[-2])

    @property
    def lower_m(self) -> Any:
        """[3] lower corner of the cube that robots have to stay in; the floor cuts it off."""
        return self.grid.origin_m

    @property
    def upper_m(self) -> Any:
        """[3] upper corner."""
        cells = np.array(self.grid.occupied.shape[-3:], np.float32)
        return self.grid.origin_m + self.grid.cell_m[..., None] * cells

    def current_mps(self, p: Any, t: Any) -> np.ndarray:
        """Velocity of the water where and when it is asked for, as far as it is known.

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
