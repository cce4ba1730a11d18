"""Position errors of the robots of a run, at its end.

    angler sitl run sitl_hold --duration 90 --out runs/hold
    python -m angler_experiments.sitl_hold runs/hold --last-s 30

Errors are those of the true position against the target, at the recorded samples; beside them the
errors of the autopilot's own filter, if recorded.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.stored_arrays import stored_array
from angler_mjx.sim.record import ESTIMATE


@dataclass(frozen=True, kw_only=True)
class HoldingError:
    """Error of one robot, over the last seconds of a run; m."""

    robot: int
    worst_m: float
    rms_m: float
    filter_worst_m: float
    """Largest error of the filter; NaN where it was not recorded."""

    def format_row(self) -> str:
        """Format a line of the table."""
        return f"{self.robot:5d} {self.worst_m:9.3f} {self.rms_m:9.3f} {self.filter_worst_m:13.3f}"


HEAD = "robot   worst m     rms m  filter off m"


def measure_errors(run: Run, last_s: float) -> list[HoldingError]:
    """Measure every robot of the last world of a run.

    Args:
        run: run with trajectories.
        last_s: measured seconds at its end.
    """
    stored = run.trajectories
    world = int(run.episodes["world"].to_numpy()[-1])
    time_s = np.asarray(stored_array(stored, "time_s")[:])
    is_late = time_s >= time_s[-1] - last_s
    p, target = (
        np.asarray(stored_array(stored, name)[world])[is_late] for name in ("p_m", "target_m")
    )
    distance_m = np.linalg.norm(p - target, axis=-1)
    filtered = np.full_like(distance_m, np.nan)
    if ESTIMATE in stored:
        estimated = np.asarray(stored_array(stored, f"{ESTIMATE}/p_m")[world])[is_late]
        filtered = np.linalg.norm(p - estimated, axis=-1)
    return [
        HoldingError(
            robot=i,
            worst_m=float(distance_m[:, i].max()),
            rms_m=float(np.sqrt(np.mean(distance_m[:, i] ** 2))),
            filter_worst_m=float(filtered[:, i].max()),
        )
        for i in range(distance_m.shape[1])
    ]


def main(run: Annotated[Path, tyro.conf.Positional], last_s: float = 30.0) -> None:
    """Print the distance of each robot from its target.

    Args:
        run: Run folder.
        last_s: Measured seconds at the end.
    """
    print(HEAD)
    for error in measure_errors(Run(run), last_s):
        print(error.format_row())


if __name__ == "__main__":
    tyro.cli(main)
