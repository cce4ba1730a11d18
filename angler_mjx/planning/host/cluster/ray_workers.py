"""Executor of planners on many machines: a thin layer over a Ray cluster that a user started.

Needs the extra ``ray``; see docs/how_to/planner_pools.md.
"""

import contextlib
import os
import pickle
import time
from typing import TYPE_CHECKING, Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.answers import Answer, failed_answer
from angler_mjx.planning.host.cluster.connection import Cluster, installed_versions
from angler_mjx.planning.host.pool import CLOSED, TRIES, Job, Pool, Runner
from angler_mjx.planning.host.process import START_S
from angler_mjx.planning.host.workers import Workers
from angler_mjx.planning.register import PlannerSpec

if TYPE_CHECKING:
    from ray.actor import ActorHandle

POLL_S = 1.0
"""Time [s] between two checks whether the pool closes."""

END_S = 5.0
"""Time limit [s] of an actor to end its process."""


class RayWorkers(Pool):
    """Pool of actors on a Ray cluster, each with a processor and `Workers` of one process.

    Methods are those of `Pool`. Deadlines [s], and planners that miss them or die, are handled as
    by `Workers`, and the same problems have the same plans. A problem whose actor or machine dies
    is planned again by another actor, once.

    The file of a planner is sent along. Modules that the file imports from its folder have to lie
    at the same path on all machines. See `docs/how_to/planner_pools.md`.
    """

    def __init__(
        self, address: str, count: int | None = None, planner: PlannerSpec | None = None
    ) -> None:
        """Join the cluster and start the actors without waiting for them.

        Args:
            address: HOST:PORT of the cluster's head; this machine has to be in the cluster.
            count: actors; one for each processor of the cluster if left out.
            planner: planner of problems that are submitted without one, as of `Workers`.

        Raises:
            ConfigError: the count is below 1 or above the number of processors; no cluster answers;
                or the machines have other versions installed.
            UnsupportedError: Ray is not installed.
        """
        if count is not None and count < 1:
            raise ConfigError(f"{count} actors cannot plan; take at least 1")
        self._cluster = Cluster(address)
        max_count = self._cluster.processors
        if count is not None and count > max_count:
            self._cluster.leave()
            raise ConfigError(
                f"the Ray cluster at {address} has {max_count} processors; it cannot hold {count} "
                "actors"
            )
        super().__init__(planner, count or max_count)
        self._actors = [ActorRunner(self, self._cluster) for _ in range(self.count)]
        self.begin(self._actors)

    def pids(self) -> list[int]:
        """Return the process ids of the actors that are up, each on its machine."""
        return [runner.pid for runner in self._actors if runner.pid is not None]

    def close(self) -> None:
        """End all actors, wait for their end, and leave the cluster."""
        try:
            super().close()
        finally:
            self._cluster.leave()


class PlanningActor:
    """Actor on a machine of the cluster: `Workers` of one process.

    Results are pickled, so that their arrays are writable as those of a process on this machine.
    """

    def __init__(self, planner: bytes) -> None:
        """Start the process.

        Args:
            planner: the pool's own `PlannerSpec` or None, pickled.
        """
        self._pool = Workers(pickle.loads(planner), 1)

    def hello(self) -> tuple[int, dict[str, str]]:
        """Return the process id and the versions installed on the machine."""
        return os.getpid(), installed_versions()

    def ping(self) -> None:
        """Return, as a sign of life."""

    def plan(self, problem: bytes, planner: bytes) -> bytes:
        """Return the answer to a problem, or the text of a RunError, pickled.

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
        """End the process."""
        self._pool.close()


class _ActorLostError(Exception):
    """An actor is gone or cannot be reached; the text is the reason."""


class ActorRunner(Runner):
    """Thread of one actor after another.

    A problem whose actor is lost is queued again, for any other actor: the cluster may need long to
    start a new one.
    """

    pid: int | None = None
    """Id of the actor's process once it is up."""

    def __init__(self, pool: Pool, cluster: Cluster) -> None:
        """Keep the cluster; no actor is started yet."""
        super().__init__(pool)
        self._cluster = cluster
        self._actor: ActorHandle | None = None

    def ready(self) -> None:
        """See `Runner.ready`; there is no time limit while other actors of the pool are up."""
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
        """See `Runner.answer`."""
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
        """See `Runner.kill`: the actor ends its process."""
        with self.guard:
            if self._actor is not None:
                self._actor.end.remote()

    def end(self) -> None:
        """See `Runner.end`."""
        if self.pid is not None and self._actor is not None:
            with contextlib.suppress(self._cluster.ray.exceptions.RayError):
                self._cluster.ray.get(self._actor.end.remote(), timeout=END_S)
        self._drop_actor()

    def _start_actor(self, since: float) -> None:
        """Start an actor and wait for it.

        Args:
            since: monotonic time [s] of the first request for an actor.
        """
        with self.guard:
            if self.pool.closing:
                raise RunError(CLOSED)
            self._actor = self._cluster.create_actor(PlanningActor, self.default_planner)
        pid, versions = self._call_actor("hello", since=since)
        self._cluster.check_versions(versions, "a machine")
        self.pid = pid

    def _call_actor(self, method: str, *arguments: object, since: float | None = None) -> Any:
        """Call a method of the actor and return its result.

        Args:
            method: name of the method.
            arguments: of the call.
            since: monotonic time [s] of the first request for an actor, while none may come up.

        Raises:
            RunError: the pool is closed, or no actor comes up.
            _ActorLostError: the actor is gone.
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
        """Return whether any actor of the pool is up."""
        return any(isinstance(runner, ActorRunner) and runner.pid for runner in self.pool.runners)

    def _drop_actor(self) -> None:
        self.pid = None
        with self.guard:
            actor, self._actor = self._actor, None
        if actor is not None:
            with contextlib.suppress(self._cluster.ray.exceptions.RayError):
                self._cluster.ray.kill(actor)


def _error_line(error: BaseException) -> str:
    """Return the first line of Ray's text, or the last line of a traceback."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    return lines[-1] if any("Traceback" in line for line in lines) else lines[0]
