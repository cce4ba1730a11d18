"""A thread that has problems planned by an actor on a cluster."""

import contextlib
import pickle
import threading
import time
from typing import Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.answers import Answer, failed
from angler_mjx.planning.host.cluster.actor import PlanningActor
from angler_mjx.planning.host.cluster.joining import Cluster
from angler_mjx.planning.host.processes.process import START_S
from angler_mjx.planning.host.processes.queued import CLOSED, Job, QueuedPool, Runner
from angler_mjx.planning.host.processes.runner import TRIES

LOOK_S = 1.0
"""Between looks at whether all is to end."""

END_S = 5.0
"""For an actor to end what it started."""


class _LostError(Exception):
    """An actor is gone, or cannot be reached; its text says how."""


class ActorRunner(Runner):
    """One actor after another, and what it plans.

    A problem whose actor is lost is put back, so that another may have it at once: the cluster may
    be long in giving a new one.
    """

    def __init__(self, pool: QueuedPool, cluster: Cluster) -> None:
        """No actor is begun yet."""
        super().__init__(pool)
        self._cluster = cluster
        self._own = pickle.dumps(None) if pool.own is None else pool.pack(pool.own)
        self._guard = threading.Lock()
        self._actor: Any = None
        self.pid: int | None = None
        """Of the actor's process, once it is up."""

    def ready(self) -> None:
        """Waits for an actor; for ever while others of the pool have theirs."""
        begin, falls = time.monotonic(), 0
        while self.pid is None:
            try:
                self._begin(begin)
            except _LostError as lost:
                falls += 1
                self._drop()
                if falls >= TRIES and not self._others():
                    raise RunError(f"no actor could be started on the cluster: {lost}") from lost
                time.sleep(LOOK_S)
            except ConfigError as error:
                raise RunError(str(error)) from error

    def answer(self, job: Job) -> Answer | None:
        """By the actor."""
        try:
            self._call("ping")
        except _LostError:
            self._drop()
            self.pool.put(job)
            return None
        begin = time.perf_counter()
        try:
            came = self._call("plan", job.sent, job.planner)
        except _LostError as lost:
            self._drop()
            job.tries += 1
            if job.tries < TRIES:
                self.pool.put(job)
                return None
            taken = time.perf_counter() - begin
            why = f"its actor died, {TRIES} times: {lost}"
            return failed(job.robots, "died", why, taken)
        given: Answer | str = pickle.loads(came)
        if isinstance(given, str):
            raise RunError(given)
        return given

    def kill(self) -> None:
        """Has the actor end what it started."""
        with self._guard:
            if self._actor is not None:
                self._actor.end.remote()

    def end(self) -> None:
        """Ends the actor, and what it started."""
        if self.pid is not None:
            with contextlib.suppress(self._cluster.ray.exceptions.RayError):
                self._cluster.ray.get(self._actor.end.remote(), timeout=END_S)
        self._drop()

    def _begin(self, since: float) -> None:
        """Has an actor come up.

        Args:
            since: when an actor was first asked for.
        """
        with self._guard:
            if self.pool.closing:
                raise RunError(CLOSED)
            self._actor = self._cluster.actor(PlanningActor, self._own)
        pid, versions = self._call("hello", since=since)
        self._cluster.check(versions, "a machine")
        self.pid = pid

    def _call(self, method: str, *given: Any, since: float | None = None) -> Any:
        """What the actor gives.

        Args:
            method: of the actor.
            given: to it.
            since: when an actor was first asked for, where none of the pool may ever come up.

        Raises:
            RunError: the pool is closed, or no actor comes up.
            _LostError: the actor is gone.
        """
        ray = self._cluster.ray
        try:
            coming = getattr(self._actor, method).remote(*given)
            while not ray.wait([coming], timeout=LOOK_S)[0]:
                if self.pool.closing:
                    raise RunError(CLOSED)
                waited_s = 0.0 if since is None else time.monotonic() - since
                if waited_s > START_S and not self._others():
                    raise RunError(
                        f"no processor of the cluster was free within {START_S:g} s; "
                        "see `ray status`"
                    )
            return ray.get(coming)
        except ray.exceptions.RayError as error:
            if self.pool.closing:
                raise RunError(CLOSED) from error
            raise _LostError(_how(error)) from error

    def _others(self) -> bool:
        """Whether any of the pool has an actor that is up."""
        return any(isinstance(one, ActorRunner) and one.pid for one in self.pool.runners)

    def _drop(self) -> None:
        self.pid = None
        with self._guard:
            actor, self._actor = self._actor, None
        if actor is not None:
            with contextlib.suppress(self._cluster.ray.exceptions.RayError):
                self._cluster.ray.kill(actor)


def _how(error: BaseException) -> str:
    """The first line of Ray's long text, but for a traceback, whose last line says more."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    return lines[-1] if any("Traceback" in line for line in lines) else lines[0]
