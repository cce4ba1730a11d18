"""What runs on a machine of a cluster: a pool of one process, and the way to it."""

import os
import pickle

from angler_mjx.errors import RunError
from angler_mjx.planning.host.cluster.versions import installed_versions
from angler_mjx.planning.host.workers import Workers
from angler_mjx.planning.register import PlannerSpec


class PlanningActor:
    """Plans one problem at a time, as `Workers` of one process do.

    What it gives back is pickled, so that arrays come as they come from a process of one's own.
    """

    def __init__(self, planner: bytes) -> None:
        """Starts the process.

        Args:
            planner: a pickled `PlannerSpec`, the pool's own planner, or None.
        """
        spec: PlannerSpec | None = pickle.loads(planner)
        self._pool = Workers(spec, 1)

    def hello(self) -> tuple[int, dict[str, str]]:
        """Its process id, and what is installed where it is."""
        return os.getpid(), installed_versions()

    def ping(self) -> None:
        """Shows that it lives."""

    def plan(self, problem: bytes, planner: bytes) -> bytes:
        """The answer to a problem; or the text of a RunError, where it cannot plan at all.

        Args:
            problem: pickled.
            planner: a pickled `PlannerSpec`.
        """
        try:
            ticket = self._pool.submit(pickle.loads(problem), pickle.loads(planner))
            return pickle.dumps(self._pool.take(ticket))
        except RunError as error:
            return pickle.dumps(str(error))

    def end(self) -> None:
        """Ends the process, and leaves nothing behind."""
        self._pool.close()
