"""Flights of single robots for formats of single agents: states, actions and masks.

The state is 19 numbers: position, attitude, velocity, goal, current. The number of other robots is
that of the dataset's teams less one, nearest first at each sample, by position and velocity
relative to the robot in W; missing robots are zeros with 0 in the mask.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.dataset import Dataset
from angler_mjx.learning.datasets.episode import Episode
from angler_mjx.robot.control.allocation import NEUTRAL_US

STATE_COLUMNS = (
    *("x_m", "y_m", "z_m"),
    *("qw", "qx", "qy", "qz"),
    *("u_mps", "v_mps", "w_mps", "p_radps", "q_radps", "r_radps"),
    *("goal_x_m", "goal_y_m", "goal_z_m"),
    *("current_x_mps", "current_y_mps", "current_z_mps"),
)
"""Names of the numbers of a state, in order; world frame, but velocities in the body frame."""

OTHER_COLUMNS = ("there", "dx_m", "dy_m", "dz_m", "dvx_mps", "dvy_mps", "dvz_mps")
"""Names of the numbers of each other robot."""

ACTIONS = {"target": ("target_x_m", "target_y_m", "target_z_m"), "pwm": ()}
"""Actions of a robot by name: set-point of its controller, world frame; or pulse widths, us. Those
of missing thrusters are neutral."""

UNITS = {
    "m": "m",
    "mps": "m/s",
    "radps": "rad/s",
    "us": "us",
    "s": "s",
    "qw": "1",
    "qx": "1",
    "qy": "1",
    "qz": "1",
    "there": "1",
}
"""Units by the last word of a number's name."""

REQUIRED_FIELDS = ("p_m", "q", "nu", "target_m", "current_mps", "pwm_us")


@dataclass(frozen=True, kw_only=True)
class ExportedFlight:
    """Flight of one robot, until its end."""

    episode: int
    """Row of the episode in the dataset's index."""
    robot: int
    outcome: str
    split: str
    task: str
    time_s: np.ndarray
    """[t] time since the start."""
    state: np.ndarray
    """float32 [t, 19]; see `STATE_COLUMNS`."""
    others: np.ndarray
    """float32 [t, others, 7]; see `OTHER_COLUMNS`."""
    action: np.ndarray
    """float32 [t, a]; see `ACTIONS`."""

    @property
    def arrived(self) -> bool:
        """Return whether the robot reached its goal."""
        return self.outcome == "reached"


def action_names(data: Dataset, action: str) -> tuple[str, ...]:
    """Return the names of the numbers of an action.

    Raises:
        ConfigError: the action is unknown.
    """
    if action not in ACTIONS:
        raise ConfigError(f"--action {action}: must be {' or '.join(ACTIONS)}")
    if action == "target":
        return ACTIONS["target"]
    max_thrusters = max(
        data.open_array(int(i), "pwm_us").shape[-1] for i in _first_episode_per_part(data)
    )
    return tuple(f"pwm_{i}_us" for i in range(max_thrusters))


def unit_of(name: str) -> str:
    """Return the unit of a number of a state, of another robot or of an action, from its name."""
    return UNITS[name.rpartition("_")[2]]


def other_names(data: Dataset) -> tuple[str, ...]:
    """Return the names of the numbers of the other robots, nearest first."""
    return tuple(
        f"other_{i}_{name}" for i in range(int(data.robots.max()) - 1) for name in OTHER_COLUMNS
    )


def iterate_flights(
    data: Dataset, action: str, *, of: Dataset | None = None
) -> Iterator[ExportedFlight]:
    """Iterate over all flights of a dataset.

    Args:
        data: dataset with the flights.
        action: see `ACTIONS`.
        of: the whole dataset of which ``data`` is a part; its teams and vehicles set the widths of
            arrays.

    Raises:
        ConfigError: the action is unknown, or a file is damaged.
    """
    full = of or data
    names = action_names(full, action)
    others = int(full.robots.max()) - 1
    for i in range(len(data)):
        episode = data.episode(i)
        yield from (
            _build_flight(i, episode, robot, others, action, len(names))
            for robot in range(episode.running.shape[1])
            if episode.running[:, robot].any()
        )


def count_flights(data: Dataset) -> int:
    """Count the flights at most: a flight that ended before its first sample is left out."""
    return int(data.robots.sum())


def _first_episode_per_part(data: Dataset) -> np.ndarray:
    """Return one episode of each part."""
    episodes: np.ndarray = np.unique(data.index["part"].to_numpy(), return_index=True)[1]
    return episodes


def _build_flight(
    number: int, episode: Episode, robot: int, others: int, action: str, width: int
) -> ExportedFlight:
    steps = int(episode.running[:, robot].sum())
    arrays: dict[str, np.ndarray] = {n: values[:steps] for n, values in episode.arrays.items()}
    recorded = arrays["target_m" if action == "target" else "pwm_us"][:, robot]
    padded = np.full((steps, width), NEUTRAL_US if action == "pwm" else 0.0, np.float32)
    padded[:, : recorded.shape[-1]] = recorded
    goal = np.broadcast_to(episode.goal_m[robot], (steps, 3))
    state = [arrays[name][:, robot] for name in ("p_m", "q", "nu")]
    state += [goal, arrays["current_mps"][:, robot]]
    about = episode.about
    return ExportedFlight(
        episode=number,
        robot=robot,
        outcome=episode.outcomes[robot],
        split=str(about["split"]),
        task=f"reach the goal, {about['scene']}, {about['robots']} robots",
        time_s=episode.time_s[:steps].astype(np.float32),
        state=np.concatenate(state, axis=1).astype(np.float32),
        others=_relative_others(arrays, robot, others),
        action=padded,
    )


def _relative_others(arrays: dict[str, np.ndarray], robot: int, max_others: int) -> np.ndarray:
    """Return the other robots relative to a robot, [t, max_others, 7], nearest first."""
    positions_m, velocity_mps = arrays["p_m"], _world_velocity(arrays["q"], arrays["nu"])
    steps, team = positions_m.shape[:2]
    features = np.zeros((steps, max_others, len(OTHER_COLUMNS)), np.float32)
    other_robots = [i for i in range(team) if i != robot]
    if not other_robots:
        return features
    offsets_m = positions_m[:, other_robots] - positions_m[:, robot, None]
    order = np.argsort(np.linalg.norm(offsets_m, axis=-1), axis=1, kind="stable")[..., None]
    relative_mps = velocity_mps[:, other_robots] - velocity_mps[:, robot, None]
    features[:, : len(other_robots), 0] = 1.0
    features[:, : len(other_robots), 1:4] = np.take_along_axis(offsets_m, order, axis=1)
    features[:, : len(other_robots), 4:7] = np.take_along_axis(relative_mps, order, axis=1)
    return features


def _world_velocity(q: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Return velocities in W from attitudes and velocities in the body frame."""
    w, v, u = q[..., :1], q[..., 1:], nu[..., :3]
    rotated: np.ndarray = u + 2.0 * np.cross(v, np.cross(v, u) + w * u)
    return rotated


def describe_columns(data: Dataset, action: str) -> dict[str, object]:
    """Describe the numbers for every format: names, units and frames."""
    names = {"state": STATE_COLUMNS, "others": OTHER_COLUMNS, "action": action_names(data, action)}
    return {
        **{key: list(columns) for key, columns in names.items()},
        "units": {name: unit_of(name) for columns in names.values() for name in columns},
        "frames": "world x east, y north, z up; body x forward, y left, z up; quaternion wxyz",
    }
