"""Problems in a queue, and threads that see to their answers: what all pools have in common."""

import pickle
import queue
import threading
from abc import ABC, abstractmethod
from collections import deque
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


@dataclass
class Job:
    """A problem that waits for its answer."""

    sent: bytes
    """The problem, pickled."""
    planner: bytes
    """As the pool packs it."""
    robots: int
    deadline_s: float
    answer: Future[Answer]
    tries: int = 0
    """Machines that it was lost with."""


class QueuedPool(ABC):
    """A `Pool` whose runners, begun by a subclass, take jobs from one queue.

    Attributes:
        count: problems that are planned at the same time.
        own: who plans where no planner is given.
        runners: what plans.
    """

    count: int
    default_planner: PlannerSpec | None
    runners: "Sequence[Runner]"

    def __init__(self, default_planner: PlannerSpec | None, count: int) -> None:
        """Nothing plans yet; see `begin`.

        Args:
            default_planner: who plans where no planner is given.
            count: runners that will be begun.

        Raises:
            ConfigError: there is no worker.
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

    @abstractmethod
    def pack(self, planner: PlannerSpec) -> bytes:
        """A planner as it travels to a process; the same one always packs into the same."""

    def begin(self, runners: "Sequence[Runner]") -> None:
        """Starts what plans."""
        self.runners = runners
        for runner in runners:
            runner.start()

    def submit(self, problem: Problem, planner: PlannerSpec | None = None) -> int:
        """As `Pool.submit`."""
        if self._closing.is_set():
            raise RunError(CLOSED)
        planner = planner or self.default_planner
        if planner is None:
            raise ConfigError("the planning workers have no planner; submit(problem, planner=...)")
        host = jax.tree.map(np.asarray, problem)
        sent = pickle.dumps(host, protocol=pickle.HIGHEST_PROTOCOL)
        packed = self.pack(planner)
        job = Job(sent, packed, problem.robots, float(problem.deadline_s), Future())
        self._next += 1
        self._futures[self._next] = job.answer
        self.put(job)
        return self._next

    def take(self, ticket: int) -> Answer:
        """As `Pool.take`."""
        answer = self._find_future(ticket)
        try:
            return answer.result()
        finally:
            del self._futures[ticket]

    def completed(
        self, tickets: Iterable[int], ahead: int | None = None
    ) -> Iterator[tuple[int, Answer]]:
        """As `Pool.completed`."""
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

    def imap(self, problems: Iterable[Problem], ahead: int | None = None) -> Iterator[Answer]:
        """Answers by the pool's own planner, in the order of the problems.

        Args:
            problems: may be a generator; only as many are drawn as are planned or wait.
            ahead: problems handed in before the first answer is awaited; twice the workers.
        """
        tickets: deque[int] = deque()
        max_waiting = max(1, 2 * self.count if ahead is None else ahead)
        for problem in problems:
            tickets.append(self.submit(problem))
            if len(tickets) >= max_waiting:
                yield self.take(tickets.popleft())
        while tickets:
            yield self.take(tickets.popleft())

    def close(self) -> None:
        """As `Pool.close`."""
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
        """Itself."""
        return self

    def __exit__(self, *why: object) -> None:
        """Closes."""
        self.close()

    # What follows is called by the runners.

    @property
    def closing(self) -> bool:
        """Whether all is to end."""
        return self._closing.is_set()

    def next_job(self) -> Job | None:
        """The next problem; None where there is none to come."""
        job = self._jobs.get()
        if self.closing and job is not None:
            self._jobs.put(job)
            return None
        return job

    def put(self, job: Job) -> None:
        """Has a problem wait, for the first time or again."""
        self._jobs.put(job)
        if self._broken is not None:
            self._fail_waiting(self._broken)
        elif self.closing:
            self._fail_waiting(RunError(CLOSED))

    def fail_all(self, error: RunError) -> None:
        """Nothing can plan: all that waits, and all that comes, is told so."""
        self._broken = self._broken or error
        self._fail_waiting(self._broken)

    def _fail_waiting(self, error: RunError) -> None:
        while True:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                return
            if job is not None:
                job.answer.set_exception(error)

    def _find_future(self, ticket: int) -> Future[Answer]:
        if ticket not in self._futures:
            raise RunError(f"ticket {ticket} was taken before, or never given")
        return self._futures[ticket]


def _report_done(done: queue.SimpleQueue[int], ticket: int, _: Future[Answer]) -> None:
    done.put(ticket)


def _final_error(error: Exception) -> RunError:
    """Any error of a runner's, so that who waits is told, and does not wait for ever."""
    if isinstance(error, RunError):
        return error
    return RunError(f"the planning workers cannot go on: {type(error).__name__}: {error}")


class Runner(threading.Thread, ABC):
    """Has one problem after another planned, somewhere."""

    def __init__(self, pool: QueuedPool) -> None:
        """It belongs to a pool, which starts it."""
        super().__init__(name="planning worker", daemon=True)
        self.pool = pool

    @abstractmethod
    def ready(self) -> None:
        """Waits until a problem can be planned.

        Raises:
            RunError: that will never be.
        """

    @abstractmethod
    def answer(self, job: Job) -> Answer | None:
        """The answer to a problem; None where it was put back.

        Raises:
            RunError: nothing can be planned any more.
        """

    @abstractmethod
    def kill(self) -> None:
        """Ends what plans, at once; called by any thread."""

    @abstractmethod
    def end(self) -> None:
        """Leaves nothing behind."""

    def run(self) -> None:
        """Until the pool is closed, or nothing can be planned any more."""
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
