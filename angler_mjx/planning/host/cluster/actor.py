"""What runs on a machine of a cluster: a pool of one process, and the way to it."""

import os
import pickle
import tempfile
from pathlib import Path

from angler_mjx.errors import RunError
from angler_mjx.planning.host.cluster.carrying import Carried, unpack
from angler_mjx.planning.host.cluster.versions import installed
from angler_mjx.planning.host.workers import Workers
from angler_mjx.planning.register import PlannerSpec


class PlanningActor:
    """Plans one problem at a time, as `Workers` of one process do.

    What it gives back is pickled, so that arrays come as they come from a process of one's own.
    """

    def __init__(self, own: bytes) -> None:
        """Starts the process.

        Args:
            own: a pickled `Carried`, the pool's own planner, or None.
        """
        self._folder = tempfile.TemporaryDirectory(prefix="angler_mjx_planners_")
        self._met: dict[bytes, PlannerSpec] = {}
        carried: Carried | None = pickle.loads(own)
        self._pool = Workers(None if carried is None else self._planner(own), 1)

    def hello(self) -> tuple[int, dict[str, str]]:
        """Its process id, and what is installed where it is."""
        return os.getpid(), installed()

    def ping(self) -> None:
        """Shows that it lives."""

    def plan(self, problem: bytes, planner: bytes) -> bytes:
        """The answer to a problem; or the text of a RunError, where it cannot plan at all.

        Args:
            problem: pickled.
            planner: a pickled `Carried`.
        """
        try:
            ticket = self._pool.submit(pickle.loads(problem), self._planner(planner))
            return pickle.dumps(self._pool.take(ticket))
        except RunError as error:
            return pickle.dumps(str(error))

    def end(self) -> None:
        """Ends the process, and leaves nothing behind."""
        self._pool.close()
        self._folder.cleanup()

    def _planner(self, planner: bytes) -> PlannerSpec:
        if planner not in self._met:
            self._met[planner] = unpack(pickle.loads(planner), Path(self._folder.name))
        return self._met[planner]
