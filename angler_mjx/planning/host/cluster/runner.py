"""A thread that has problems planned by an actor on a cluster."""

import contextlib
import pickle
import threading
import time
from typing import Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.answers import Answer, failed_answer
from angler_mjx.planning.host.cluster.actor import PlanningActor
from angler_mjx.planning.host.cluster.connection import Cluster
from angler_mjx.planning.host.processes.process import START_S
from angler_mjx.planning.host.processes.queued_pool import CLOSED, Job, QueuedPool, Runner
from angler_mjx.planning.host.processes.runner import TRIES

POLL_S = 1.0
"""Between looks at whether all is to end."""

END_S = 5.0
"""For an actor to end what it started."""


class _ActorLostError(Exception):
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
        self._default_planner = (
            pickle.dumps(None) if pool.default_planner is None else pool.pack(pool.default_planner)
        )
        self._guard = threading.Lock()
        self._actor: Any = None
        self.pid: int | None = None
        """Of the actor's process, once it is up."""

    def ready(self) -> None:
        """Waits for an actor; for ever while others of the pool have theirs."""
        begin, n_failures = time.monotonic(), 0
        while self.pid is None:
            try:
                self._start_actor(begin)
            except _ActorLostError as lost:
                n_failures += 1
                self._drop_actor()
                if n_failures >= TRIES and not self._has_live_actor():
                    raise RunError(f"no actor could be started on the cluster: {lost}") from lost
                time.sleep(POLL_S)
            except ConfigError as error:
                raise RunError(str(error)) from error

    def answer(self, job: Job) -> Answer | None:
        """By the actor."""
        try:
            self._call_actor("ping")
        except _ActorLostError:
            self._drop_actor()
            self.pool.put(job)
            return None
        begin = time.perf_counter()
        try:
            reply = self._call_actor("plan", job.sent, job.planner)
        except _ActorLostError as lost:
            self._drop_actor()
            job.tries += 1
            if job.tries < TRIES:
                self.pool.put(job)
                return None
            elapsed_s = time.perf_counter() - begin
            reason = f"its actor died, {TRIES} times: {lost}"
            return failed_answer(job.robots, "died", reason, elapsed_s)
        result: Answer | str = pickle.loads(reply)
        if isinstance(result, str):
            raise RunError(result)
        return result

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
        self._drop_actor()

    def _start_actor(self, since: float) -> None:
        """Has an actor come up.

        Args:
            since: when an actor was first asked for.
        """
        with self._guard:
            if self.pool.closing:
                raise RunError(CLOSED)
            self._actor = self._cluster.create_actor(PlanningActor, self._default_planner)
        pid, versions = self._call_actor("hello", since=since)
        self._cluster.check_versions(versions, "a machine")
        self.pid = pid

    def _call_actor(self, method: str, *arguments: Any, since: float | None = None) -> Any:
        """What the actor gives.

        Args:
            method: of the actor.
            arguments: to it.
            since: when an actor was first asked for, where none of the pool may ever come up.

        Raises:
            RunError: the pool is closed, or no actor comes up.
            _LostError: the actor is gone.
        """
        ray = self._cluster.ray
        try:
            reference = getattr(self._actor, method).remote(*arguments)
            while not ray.wait([reference], timeout=POLL_S)[0]:
                if self.pool.closing:
                    raise RunError(CLOSED)
                waited_s = 0.0 if since is None else time.monotonic() - since
                if waited_s > START_S and not self._has_live_actor():
                    raise RunError(
                        f"no processor of the cluster was free within {START_S:g} s; "
                        "see `ray status`"
                    )
            return ray.get(reference)
        except ray.exceptions.RayError as error:
            if self.pool.closing:
                raise RunError(CLOSED) from error
            raise _ActorLostError(_error_line(error)) from error

    def _has_live_actor(self) -> bool:
        """Whether any of the pool has an actor that is up."""
        return any(isinstance(runner, ActorRunner) and runner.pid for runner in self.pool.runners)

    def _drop_actor(self) -> None:
        self.pid = None
        with self._guard:
            actor, self._actor = self._actor, None
        if actor is not None:
            with contextlib.suppress(self._cluster.ray.exceptions.RayError):
                self._cluster.ray.kill(actor)


def _error_line(error: BaseException) -> str:
    """The first line of Ray's long text, but for a traceback, whose last line says more."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    return lines[-1] if any("Traceback" in line for line in lines) else lines[0]
