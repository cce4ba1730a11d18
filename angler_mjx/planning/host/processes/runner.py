"""A thread that has problems planned by a process of this machine."""

import pickle
import threading
import time

from angler_mjx.errors import RunError
from angler_mjx.planning.answers import Answer, failed_answer
from angler_mjx.planning.host.processes.process import START_S, WorkerDiedError, WorkerProcess
from angler_mjx.planning.host.processes.queued_pool import CLOSED, Job, QueuedPool, Runner

DEADLINE_FACTOR = 1.1
"""Of its deadline a planner may take; then it is ended."""

GRACE_S = 0.5
"""For the answer's way through the pipe, and the checks, on top of it."""

TRIES = 2
"""Processes that a problem may cost: one may have been killed by somebody else."""


def deadline_reason(deadline_s: float, how: str) -> str:
    """Return the reason of a robot whose planner missed its deadline."""
    return f"the planner missed its deadline of {deadline_s:g} s ({how})"


class ProcessRunner(Runner):
    """One worker process after another, and what it plans."""

    def __init__(self, pool: QueuedPool) -> None:
        """No process is started yet."""
        super().__init__(pool)
        self._made_of = (
            pickle.dumps(None) if pool.default_planner is None else pool.pack(pool.default_planner)
        )
        self._guard = threading.Lock()
        self._process: WorkerProcess | None = None

    def pid(self) -> int | None:
        """Of the process that lives now."""
        process = self._process
        return None if process is None else process.pid

    def ready(self) -> None:
        """Starts a process, and waits for it."""
        self._ready_process()

    def kill(self) -> None:
        """Ends the process."""
        with self._guard:
            if self._process is not None:
                self._process.kill()

    def end(self) -> None:
        """Ends the process, and waits for its end."""
        with self._guard:
            if self._process is not None:
                self._process.end()
            self._process = None

    def answer(self, job: Job) -> Answer:
        """By the process, or by another where it dies."""
        limit_s = DEADLINE_FACTOR * job.deadline_s
        for _ in range(TRIES):
            process = self._ready_process()
            begin = time.perf_counter()
            try:
                process.send(job.planner)
                process.send(job.sent)
                process.receive("began", START_S)
                begin = time.perf_counter()
                received = process.receive("done", limit_s + GRACE_S)
            except TimeoutError:
                elapsed_s = time.perf_counter() - begin
                self.end()
                reason = deadline_reason(job.deadline_s, f"ended after {elapsed_s:.3g} s")
                return failed_answer(job.robots, "timeout", reason, elapsed_s)
            except WorkerDiedError as died:
                elapsed_s, exit_reason = time.perf_counter() - begin, str(died)
                self.end()
                if self.pool.closing:
                    raise RunError(CLOSED) from died
                continue
            answer: Answer = received[0]
            if answer.planning_s > limit_s:
                reason = deadline_reason(job.deadline_s, f"took {answer.planning_s:.3g} s")
                return failed_answer(job.robots, "timeout", reason, answer.planning_s)
            return answer
        return failed_answer(
            job.robots, "died", f"its process died, {TRIES} times: {exit_reason}", elapsed_s
        )

    def _ready_process(self) -> WorkerProcess:
        """A process that waits for a problem; a new one where there is none."""
        reason = ""
        if self._process is not None:
            return self._process
        for _ in range(TRIES):
            with self._guard:
                if self.pool.closing:
                    raise RunError(CLOSED)
                try:
                    self._process = WorkerProcess()
                except OSError as error:
                    raise RunError(f"no planning worker could be started: {error}") from error
            try:
                self._process.start(self._made_of)
                return self._process
            except (WorkerDiedError, TimeoutError) as error:
                reason = str(error)
                self.end()
            except RunError:
                self.end()
                raise
        default_planner = self.pool.default_planner
        planner_text = (
            "" if default_planner is None else f" that plans with {default_planner.reference.name}"
        )
        raise RunError(f"no worker{planner_text} could be started: {reason}")
