"""Selection of notable worlds of a run."""

from collections.abc import Callable

import numpy as np

from angler_mjx.runs.storage.folder import Run


def worst_world(run: Run) -> int:
    """Return the world with the worst result.

    For a run with a task: a world that did not complete it, the one with the least progress first;
    where all completed it, the one that did so last. Ties, and runs without a task: the world in
    which most robots failed. Further ties go to the world with more different causes of failure,
    then to the one whose first failure came earliest, then to the lowest index.
    """

    def badness(rows: dict[str, np.ndarray]) -> tuple[float, ...]:
        failed = rows["outcome"] != "reached"
        causes = len(set(rows["outcome"][failed]))
        first = np.min(rows["failure_time_s"], where=failed, initial=np.inf)
        return (*_task_delay(rows), float(np.sum(failed)), float(causes), -float(first))

    return _best_world(run, badness)


def good_world(run: Run) -> int:
    """Return a world with a good result.

    Most robots arrived; among such worlds the one with the smallest min clearance, because it shows
    most; then the lowest index. For a run with a task: a world that completed it, with most robots
    that did their part, then the earliest completion.
    """

    def goodness(rows: dict[str, np.ndarray]) -> tuple[float, ...]:
        arrived = float(np.sum(rows["outcome"] == "reached"))
        missing, *later = _task_delay(rows)
        tight = -float(np.nanmin(rows["min_clearance_m"]))
        return (-missing, arrived, *(-part for part in later), tight)

    return _best_world(run, goodness)


def _task_delay(rows: dict[str, np.ndarray]) -> tuple[float, float, float]:
    """Return whether the task is incomplete, the fraction that is left, and completion time [s].

    Each is 0 where it does not apply, all of them without a task.
    """
    progress, completed_s = float(rows["task_progress"][0]), float(rows["task_completed_s"][0])
    if np.isnan(progress):
        return 0.0, 0.0, 0.0
    if np.isnan(completed_s):
        return 1.0, 1.0 - progress, 0.0
    return 0.0, 0.0, completed_s


def _best_world(run: Run, score: Callable[[dict[str, np.ndarray]], tuple[float, ...]]) -> int:
    table = run.episodes
    names = (
        "outcome",
        "failure_time_s",
        "min_clearance_m",
        "task_progress",
        "task_completed_s",
    )
    columns: dict[str, np.ndarray] = {
        name: table[name].to_numpy(zero_copy_only=False) for name in names
    }
    world = table["world"].to_numpy()
    starts = np.flatnonzero(np.r_[True, world[1:] != world[:-1]])
    parts = zip(starts, np.r_[starts[1:], world.size], strict=True)
    scores = [
        (score({name: values[a:b] for name, values in columns.items()}), -int(world[a]))
        for a, b in parts
    ]
    return -max(scores)[1]
