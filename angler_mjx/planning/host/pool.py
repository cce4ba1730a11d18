"""Executors of planners on the host: problems in a queue, and threads that wait for answers.

The processes of `workers.Workers` are on this machine, those of `cluster.ray_workers.RayWorkers` on
many; both have the same methods and give the same plans.

Executors of libraries were tried. Those of ``concurrent.futures`` cannot end one task and lose all
others with a process. Pebble 5.2 ends a task at its limit, but its processes run the user's program
again where that has no main guard, outlive a killed parent while a planner holds the interpreter,
leave children of a planner behind, and count its warm-up as planning time.
"""

import pickle
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.answers import Answer
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec

CLOSED = "the planning workers are closed"
"""Message of a closed pool."""

TRIES = 2
"""Processes that a problem may cost: one may have been killed from outside."""


@dataclass
class Job:
    """A problem that waits for its answer."""

    sent: bytes
    """The problem, pickled."""
    planner: bytes
    """The `PlannerSpec`, pickled."""
    robots: int
    """Number of robots."""
    deadline_s: float
    """Time limit [s] of the planner."""
    answer: Future[Answer]
    tries: int = 0
    """Processes that it was lost with."""


class Pool(ABC):
    """Base of pools, which plan problems in processes; their runners take jobs from one queue.

    A context manager: after its ``with`` statement, and after an exception too, its processes are
    gone.

    Attributes:
        count: problems that are planned at the same time.
        default_planner: planner of problems that are submitted without one.
        runners: threads that plan.
    """

    count: int
    default_planner: PlannerSpec | None
    runners: "Sequence[Runner]"

    def __init__(self, default_planner: PlannerSpec | None, count: int) -> None:
        """Start nothing; see `begin`.

        Args:
            default_planner: planner of problems that are submitted without one.
            count: runners that will begin.

        Raises:
            ConfigError: the count is below 1.
        """
        if count < 1:
            raise ConfigError(f"{count} workers cannot plan; take at least 1")
        self.count, self.default_planner = count, default_planner
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._futures: dict[int, Future[Answer]] = {}
        self._next = 0
        self._closing = threading.Event()
        self._broken: RunError | None = None
        self.runners = ()

    def begin(self, runners: "Sequence[Runner]") -> None:
        """Start the runners."""
        self.runners = runners
        for runner in runners:
            runner.start()

    def submit(self, problem: Problem, planner: PlannerSpec | None = None) -> int:
        """Add a problem and return the ticket of its answer.

        Args:
            problem: arrays of NumPy, or of JAX, which are fetched.
            planner: planner of the problem; that of the pool if left out. A planner that cannot be
                made gives an answer with the status ``error`` and the reason.

        Raises:
            ConfigError: the planner is left out, and the pool has none.
            RunError: the pool is closed, or cannot plan.
        """
        if self._closing.is_set():
            raise RunError(CLOSED)
        planner = planner or self.default_planner
        if planner is None:
            raise ConfigError("the planning workers have no planner; submit(problem, planner=...)")
        host = jax.tree.map(np.asarray, problem)
        sent = pickle.dumps(host, protocol=pickle.HIGHEST_PROTOCOL)
        deadline_s = float(problem.deadline_s)
        job = Job(sent, pickle.dumps(planner), problem.robots, deadline_s, Future())
        self._next += 1
        self._futures[self._next] = job.answer
        self.put(job)
        return self._next

    def take(self, ticket: int) -> Answer:
        """Wait for the answer to a problem and return it, once.

        Raises:
            RunError: the pool is closed or cannot plan; or the ticket was taken before.
        """
        answer = self._find_future(ticket)
        try:
            return answer.result()
        finally:
            del self._futures[ticket]

    def completed(
        self, tickets: Iterable[int], ahead: int | None = None
    ) -> Iterator[tuple[int, Answer]]:
        """Yield tickets and their answers in the order in which these come, and take them.

        Args:
            tickets: may be a generator that submits problems.
            ahead: limit of tickets without an answer; left out: all are taken at once.

        Raises:
            RunError: as `take`.
        """
        done: queue.SimpleQueue[int] = queue.SimpleQueue()
        remaining = iter(tickets)

        def submit_next(max_count: int | None) -> int:
            batch = list(islice(remaining, max_count))
            for ticket in batch:
                self._find_future(ticket).add_done_callback(partial(_report_done, done, ticket))
            return len(batch)

        waiting = submit_next(None if ahead is None else max(1, ahead))
        while waiting:
            ticket = done.get()
            answer = self.take(ticket)
            waiting += submit_next(1) - 1
            yield ticket, answer

    def close(self) -> None:
        """End all processes and wait for their end; problems without an answer are lost."""
        if self._closing.is_set():
            return
        self._closing.set()
        for runner in self.runners:
            runner.kill()
            self._jobs.put(None)
        for runner in self.runners:
            runner.join()
        self._fail_waiting(RunError(CLOSED))

    def __enter__(self) -> Self:
        """Return the pool."""
        return self

    def __exit__(self, *why: object) -> None:
        """Close the pool."""
        self.close()

    # The runners call the methods below.

    @property
    def closing(self) -> bool:
        """Return whether the pool is closed or closing."""
        return self._closing.is_set()

    def next_job(self) -> Job | None:
        """Wait for the next problem and return it; None once the pool closes."""
        job = self._jobs.get()
        if self.closing and job is not None:
            self._jobs.put(job)
            return None
        return job

    def put(self, job: Job) -> None:
        """Queue a problem, for the first time or again."""
        self._jobs.put(job)
        if self._broken is not None:
            self._fail_waiting(self._broken)
        elif self.closing:
            self._fail_waiting(RunError(CLOSED))

    def fail_all(self, error: RunError) -> None:
        """Answer all present and later problems with an error, as no process can plan."""
        self._broken = self._broken or error
        self._fail_waiting(self._broken)

    def _fail_waiting(self, error: RunError) -> None:
        """Answer the queued problems with an error; the runners still find the pool's end."""
        n_ends = 0
        while True:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                break
            if job is None:
                n_ends += 1
            else:
                job.answer.set_exception(error)
        for _ in range(n_ends):
            self._jobs.put(None)

    def _find_future(self, ticket: int) -> Future[Answer]:
        if ticket not in self._futures:
            raise RunError(f"ticket {ticket} was taken before, or never given")
        return self._futures[ticket]


def _report_done(done: queue.SimpleQueue[int], ticket: int, _: Future[Answer]) -> None:
    done.put(ticket)


def _final_error(error: Exception) -> RunError:
    """Return any error of a runner as one that ends the waiting of callers."""
    if isinstance(error, RunError):
        return error
    return RunError(f"the planning workers cannot go on: {type(error).__name__}: {error}")


class Runner(threading.Thread, ABC):
    """Thread of a pool that has one problem after another planned by a process."""

    def __init__(self, pool: Pool) -> None:
        """Keep the pool, which starts the thread, and pack its own planner."""
        super().__init__(name="planning worker", daemon=True)
        self.pool = pool
        self.default_planner = pickle.dumps(pool.default_planner)
        self.guard = threading.Lock()

    @abstractmethod
    def ready(self) -> None:
        """Wait until a problem can be planned.

        Raises:
            RunError: no process can be started.
        """

    @abstractmethod
    def answer(self, job: Job) -> Answer | None:
        """Return the answer to a problem; None if it was queued again.

        Raises:
            RunError: nothing can be planned any more.
        """

    @abstractmethod
    def kill(self) -> None:
        """End the process at once; any thread may call it."""

    @abstractmethod
    def end(self) -> None:
        """End the process and wait for its end."""

    def run(self) -> None:
        """Plan until the pool closes, or nothing can be planned any more."""
        try:
            self.ready()
            while (job := self.pool.next_job()) is not None:
                try:
                    answer = self.answer(job)
                except Exception as error:
                    job.answer.set_exception(_final_error(error))
                    raise
                if answer is not None:
                    job.answer.set_result(answer)
                self.ready()
        except Exception as error:
            self.pool.fail_all(_final_error(error))
        finally:
            self.end()
