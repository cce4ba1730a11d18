"""Rows and columns of the comparison: tables of planners, and seas."""

from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp

from angler_experiments.learned_planner import planner
from angler_experiments.learned_planner.train import examples
from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable, JsonValue
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.scenario.scenario import Scenario

SEED = 2_000_003
"""Seed of the evaluated worlds."""
POINTS = 32
PLANNERS = ("straight", "drawn", "noise", "learned", "grid", "priority")
_SAMPLING_ROWS: dict[str, JsonTable] = {
    "drawn": {"repair": False},
    "noise, not pushed": {"draw": "noise", "pushes": 0},
    "learned, not pushed": {"pushes": 0},
    "noise": {"draw": "noise"},
    "learned": {},
}
"""Settings of rows that sample paths; without pushes these are checked and chosen, but not
moved."""


@dataclass(frozen=True, kw_only=True)
class Sea:
    """Conditions in which planners are compared."""

    label: str
    preset: str = "reef"
    robots: int = 8
    still: bool = True
    speed: float = 1.0
    """Current as a multiple of that of `reef_fleet`."""


SEAS = {
    sea.label: sea
    for sea in (
        Sea(label="reef"),
        Sea(label="dense", preset="dense"),
        Sea(label="reef, 16 robots", robots=16),
        Sea(label="dense, 16 robots", preset="dense", robots=16),
        Sea(label="reef, sea", still=False),
        Sea(label="reef, current x 1.5", still=False, speed=1.5),
        Sea(label="shifted", preset="dense", robots=16, still=False, speed=1.5),
    )
}
"""Seas by their labels; ``shifted`` is dense rock, 16 robots and a stronger current at once."""


class StraightRow:
    """Planner of straight lines at cruise speed, without collision checks."""

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Return paths [world, robot]."""
        team = problems.team
        distance_m = jnp.sqrt(jnp.sum((team.goal_m - team.start_m) ** 2, axis=-1))
        end = distance_m / (0.999 * team.cruise_speed_mps)
        is_goal = jnp.arange(POINTS) > 0
        position_m = jnp.where(
            is_goal[:, None], team.goal_m[..., None, :], team.start_m[..., None, :]
        )
        return Trajectory(
            time_s=jnp.where(is_goal, end[..., None], 0.0),
            position_m=position_m,
            found=jnp.ones(distance_m.shape, bool),
        )


def planner_table(name: str, **settings: JsonValue) -> JsonTable:
    """Return the table ``planner`` of a row.

    Planners of this package are named by their files, so that nothing needs to be installed.

    Args:
        name: one of `PLANNERS`, or of those not pushed.
        settings: settings of the learned planner, in the rows that take them.

    Raises:
        ConfigError: the row does not exist.
    """
    if name in _SAMPLING_ROWS:
        class_path = f"{Path(planner.__file__).resolve()}:LearnedPlanner"
        return {"name": class_path, "LearnedPlanner": settings | _SAMPLING_ROWS[name]}
    if name not in PLANNERS:
        raise ConfigError(f"row {name!r}: there is {'; '.join({*PLANNERS, *_SAMPLING_ROWS})}")
    return {"name": f"{Path(__file__).resolve()}:StraightRow" if name == "straight" else name}


def samples_paths(name: str) -> bool:
    """Return whether a row samples paths."""
    return name in _SAMPLING_ROWS


def uses_network(name: str) -> bool:
    """Return whether a row depends on the network."""
    return samples_paths(name) and _SAMPLING_ROWS[name].get("draw") != "noise"


def find_sea(label: str) -> Sea:
    """Find a sea by its label.

    Raises:
        ConfigError: the sea does not exist.
    """
    if label not in SEAS:
        raise ConfigError(f"sea {label!r}: there is {'; '.join(SEAS)}")
    return SEAS[label]


def build_scenario(sea: Sea, planner: JsonTable, worlds: int) -> Scenario:
    """Build the scenario of one row."""
    return examples.build_scenario(
        preset=sea.preset,
        robots=sea.robots,
        still=sea.still,
        speed=sea.speed,
        worlds=worlds,
        planner=planner | {"points": POINTS},
        seed=SEED,
    )
