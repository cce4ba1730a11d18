"""Processes that plan: what a planner does there harms nobody but its own problem.

Each has one thread and plans one problem at a time. One that takes too long is killed, one that
dies is replaced, and the pool goes on. All end with the process that made them, however that ends.
"""

import pickle
import queue
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.answers import Answer, failed
from angler_mjx.planning.host.processes.process import START_S, DiedError, WorkerProcess
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec

LATE = 1.1
"""Of its deadline a planner may take; then it is ended."""

GRACE_S = 0.5
"""For the answer's way through the pipe, and the checks, on top of it."""

TRIES = 2
"""Processes that a problem may cost: one may have been killed by somebody else."""


@dataclass(frozen=True)
class _Job:
    sent: bytes
    """The problem, pickled."""
    robots: int
    deadline_s: float
    answer: Future[Answer]


class Workers:
    """Worker processes that all plan with the same planner.

    Problems are answered in any order, and may be handed in while others are planned. A planner
    that has a method ``warm_up(problem)`` is given its process's first problem there before the
    clock starts, to compile; ``extras`` of a planner (names and numbers of its last plan) stand in
    the answer.

    An answer's planner took at most 1.1 times the problem's deadline: what came later is not
    believed, and `GRACE_S` after that its process is killed. A problem whose process dies is
    planned again, once, as somebody else may have killed it.

    Use it in a ``with`` statement: on leaving it, by an exception too, all processes are gone.
    """

    def __init__(self, make: PlannerSpec, count: int) -> None:
        """Starts the processes; does not wait for them.

        Args:
            make: what they plan with.
            count: processes, at least 1. Each imports JAX, though only a planner that computes
                with it starts it: some 3 s and 200 MB where nothing else is imported.

        Raises:
            ConfigError: there is no worker.
        """
        if count < 1:
            raise ConfigError(f"{count} workers cannot plan; take at least 1")
        made_of = pickle.dumps(make)
        self.count = count
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._given: dict[int, Future[Answer]] = {}
        self._next = 0
        self._closing = threading.Event()
        self._broken: RunError | None = None
        self._runners = [_Runner(self, make.reference.name, made_of) for _ in range(count)]
        for runner in self._runners:
            runner.start()

    def submit(self, problem: Problem) -> int:
        """Hands a problem in.

        Args:
            problem: arrays of NumPy, or of JAX, which are fetched.

        Returns:
            The ticket to `take` the answer with.

        Raises:
            RunError: the workers are closed, or the planner cannot be made.
        """
        if self._closing.is_set():
            raise RunError("the planning workers are closed")
        host = jax.tree.map(np.asarray, problem)
        sent = pickle.dumps(host, protocol=pickle.HIGHEST_PROTOCOL)
        job = _Job(sent, problem.robots, float(problem.deadline_s), Future())
        self._next += 1
        self._given[self._next] = job.answer
        self._jobs.put(job)
        if self._broken is not None:
            self.refuse(self._broken)
        return self._next

    def take(self, ticket: int) -> Answer:
        """The answer to a problem, once; waits for it.

        Raises:
            RunError: the planner cannot be made in a worker; or the ticket was taken before.
        """
        if ticket not in self._given:
            raise RunError(f"ticket {ticket} was taken before, or never given")
        try:
            return self._given[ticket].result()
        finally:
            del self._given[ticket]

    def imap(self, problems: Iterable[Problem], ahead: int | None = None) -> Iterator[Answer]:
        """Answers, in the order of the problems.

        Args:
            problems: may be a generator; only as many are drawn as are planned or wait.
            ahead: problems handed in before the first answer is awaited; twice the workers.
        """
        tickets: deque[int] = deque()
        most = max(1, 2 * self.count if ahead is None else ahead)
        for problem in problems:
            tickets.append(self.submit(problem))
            if len(tickets) >= most:
                yield self.take(tickets.popleft())
        while tickets:
            yield self.take(tickets.popleft())

    def pids(self) -> list[int]:
        """Process ids of the workers that live now."""
        return [pid for runner in self._runners if (pid := runner.pid()) is not None]

    def close(self) -> None:
        """Ends all workers and waits for their end; problems that are not answered are lost."""
        if self._closing.is_set():
            return
        self._closing.set()
        for runner in self._runners:
            runner.kill()
            self._jobs.put(None)
        for runner in self._runners:
            runner.join()
        self.refuse(RunError("the planning workers are closed"))

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *why: object) -> None:
        """Closes."""
        self.close()

    # What follows is called by the runners.

    def job(self) -> _Job | None:
        """The next problem; None where there is none to come."""
        job = self._jobs.get()
        return None if self._closing.is_set() else job

    def broken(self, error: RunError) -> None:
        """The planner cannot be made: all that waits, and all that comes, is told so."""
        self._broken = self._broken or error
        self.refuse(self._broken)

    def refuse(self, error: RunError) -> None:
        """Tells all who wait."""
        while True:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                return
            if job is not None:
                job.answer.set_exception(error)

    @property
    def closing(self) -> bool:
        """Whether all is to end."""
        return self._closing.is_set()


class _Runner(threading.Thread):
    """One worker process after another, and what it plans."""

    def __init__(self, pool: Workers, name: str, made_of: bytes) -> None:
        super().__init__(name="planning worker", daemon=True)
        self._pool = pool
        self._planner = name
        self._made_of = made_of
        self._guard = threading.Lock()
        self._process: WorkerProcess | None = None

    def pid(self) -> int | None:
        process = self._process
        return None if process is None else process.pid

    def kill(self) -> None:
        with self._guard:
            if self._process is not None:
                self._process.kill()

    def run(self) -> None:
        try:
            self._ready()
            while (job := self._pool.job()) is not None:
                try:
                    job.answer.set_result(self._answer(job))
                except RunError as error:
                    job.answer.set_exception(error)
                    raise
        except RunError as error:
            self._pool.broken(error)
        finally:
            self._end()

    def _answer(self, job: _Job) -> Answer:
        limit_s = LATE * job.deadline_s
        for _ in range(TRIES):
            process = self._ready()
            begin = time.perf_counter()
            try:
                process.send(job.sent)
                process.receive("began", START_S)
                begin = time.perf_counter()
                given = process.receive("done", limit_s + GRACE_S)
            except TimeoutError:
                taken = time.perf_counter() - begin
                self._end()
                return failed(job.robots, "timeout", f"had to be ended after {taken:.3g} s", taken)
            except DiedError as died:
                taken, how = time.perf_counter() - begin, str(died)
                self._end()
                if self._pool.closing:
                    raise RunError("the planning workers are closed") from died
                continue
            answer: Answer = given[0]
            if answer.planning_s > limit_s:
                late = f"took {answer.planning_s:.3g} s; it had {job.deadline_s:g} s"
                return failed(job.robots, "timeout", late, answer.planning_s)
            return answer
        return failed(job.robots, "died", f"its process died, {TRIES} times: {how}", taken)

    def _ready(self) -> WorkerProcess:
        """A process that waits for a problem; a new one where there is none."""
        how = ""
        if self._process is not None:
            return self._process
        for _ in range(TRIES):
            with self._guard:
                if self._pool.closing:
                    raise RunError("the planning workers are closed")
                try:
                    self._process = WorkerProcess()
                except OSError as error:
                    raise RunError(f"no planning worker could be started: {error}") from error
            try:
                self._process.start(self._made_of)
                return self._process
            except (DiedError, TimeoutError) as error:
                how = str(error)
                self._end()
            except RunError:
                self._end()
                raise
        raise RunError(f"no worker that plans with {self._planner} could be started: {how}")

    def _end(self) -> None:
        with self._guard:
            if self._process is not None:
                self._process.end()
            self._process = None
