"""Which worlds of a run are worth looking at."""

from collections.abc import Callable
from typing import Any

import numpy as np

from angler_mjx.storage.folder import Run


def worst_world(run: Run) -> int:
    """The world in which most robots failed.

    Ties go to the world with more different causes of failure, then to the one whose first failure
    came earliest, then to the lowest index.
    """

    def badness(rows: dict[str, np.ndarray]) -> tuple[float, ...]:
        failed = rows["outcome"] != "reached"
        causes = len(set(rows["outcome"][failed]))
        first = np.min(rows["failure_time_s"], where=failed, initial=np.inf)
        return float(np.sum(failed)), float(causes), -float(first)

    return _best(run, badness)


def good_world(run: Run) -> int:
    """The world that went well although it was tight.

    Most robots arrived; among such worlds the one with the smallest least clearance, because there
    is most to see; then the lowest index.
    """

    def goodness(rows: dict[str, np.ndarray]) -> tuple[float, ...]:
        arrived = rows["outcome"] == "reached"
        return float(np.sum(arrived)), -float(np.nanmin(rows["min_clearance_m"]))

    return _best(run, goodness)


def _best(run: Run, score: Callable[[dict[str, np.ndarray]], tuple[float, ...]]) -> int:
    table = run.episodes
    names = ("outcome", "failure_time_s", "min_clearance_m")
    columns: dict[str, Any] = {name: table[name].to_numpy(zero_copy_only=False) for name in names}
    world = table["world"].to_numpy()
    starts = np.flatnonzero(np.r_[True, world[1:] != world[:-1]])
    parts = zip(starts, np.r_[starts[1:], world.size], strict=True)
    scores = [
        (score({name: values[a:b] for name, values in columns.items()}), -int(world[a]))
        for a, b in parts
    ]
    return -max(scores)[1]
