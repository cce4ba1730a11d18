"""What runs on a machine of a cluster: a pool of one process, and the way to it."""

import hashlib
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
        self._folder: tempfile.TemporaryDirectory[str] | None = None
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
        if self._folder is not None:
            self._folder.cleanup()

    def _planner(self, planner: bytes) -> PlannerSpec:
        if planner not in self._met:
            self._met[planner] = unpack(pickle.loads(planner), self._put)
        return self._met[planner]

    def _put(self, name: str, text: bytes) -> Path:
        """Writes a file that came along."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="angler_mjx_planners_")
        put = Path(self._folder.name, hashlib.sha256(text).hexdigest(), name)
        put.parent.mkdir(exist_ok=True)
        put.write_bytes(text)
        return put
