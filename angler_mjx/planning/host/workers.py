"""Worker processes on this machine; a planner's faults affect its own problem only.

Each process has one thread and plans one problem at a time. A process that takes too long is
killed, one that dies is replaced, and the pool goes on. All end with the process that made them,
however that ends.
"""

import time

from angler_mjx.errors import RunError
from angler_mjx.planning.answers import Answer, failed_answer
from angler_mjx.planning.host.pool import CLOSED, TRIES, Job, Pool, Runner
from angler_mjx.planning.host.process import START_S, WorkerDiedError, WorkerProcess
from angler_mjx.planning.register import PlannerSpec

DEADLINE_FACTOR = 1.1
"""Time limit of a planner as a multiple of its deadline."""

GRACE_S = 0.5
"""Time [s] beyond the limit for checks and the transfer of the answer."""


class Workers(Pool):
    """Pool of processes on this machine.

    Methods are those of `Pool`. Problems are answered in any order, and may be submitted while
    others are planned. A process makes a planner at its first problem and keeps it; all planners of
    a process share its memory and imports. A planner with a method ``warm_up(problem)`` receives
    the first problem there before the clock starts, to compile. The answer holds the planner's
    ``extras`` (names and numbers of its last plan).

    A planner has 1.1 times the problem's deadline: a later answer is not used, and half a second
    after the limit the process is killed. A problem whose process dies is planned again, once.
    """

    def __init__(self, make: PlannerSpec | None, count: int) -> None:
        """Start the processes without waiting for them.

        Args:
            make: planner of problems that are submitted without one, made at once; if it cannot be
                made, `take` raises RunError. None: each problem is submitted with a planner.
            count: processes, at least 1. Each imports JAX, though only a planner that computes with
                it starts it: some 3 s and 200 MB where nothing else is imported.

        Raises:
            ConfigError: the count is below 1.
        """
        super().__init__(make, count)
        self._processes = [ProcessRunner(self) for _ in range(count)]
        self.begin(self._processes)

    def pids(self) -> list[int]:
        """Return the ids of the processes that live now."""
        processes = [runner.process for runner in self._processes]
        return [process.pid for process in processes if process is not None]


class ProcessRunner(Runner):
    """Thread of one worker process after another."""

    process: WorkerProcess | None = None
    """The process that lives now."""

    def ready(self) -> None:
        """See `Runner.ready`."""
        self._ready_process()

    def kill(self) -> None:
        """See `Runner.kill`."""
        with self.guard:
            if self.process is not None:
                self.process.kill()

    def end(self) -> None:
        """See `Runner.end`."""
        with self.guard:
            if self.process is not None:
                self.process.end()
            self.process = None

    def answer(self, job: Job) -> Answer:
        """See `Runner.answer`; a process that dies is replaced once."""
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
                return _missed_deadline(job, f"ended after {elapsed_s:.3g} s", elapsed_s)
            except WorkerDiedError as died:
                elapsed_s, exit_reason = time.perf_counter() - begin, str(died)
                self.end()
                if self.pool.closing:
                    raise RunError(CLOSED) from died
                continue
            answer: Answer = received[0]
            if answer.planning_s > limit_s:
                taken_s = answer.planning_s
                return _missed_deadline(job, f"took {taken_s:.3g} s", taken_s)
            return answer
        return failed_answer(
            job.robots, "died", f"its process died, {TRIES} times: {exit_reason}", elapsed_s
        )

    def _ready_process(self) -> WorkerProcess:
        """Return a process that waits for a problem, a new one if there is none."""
        if self.process is not None:
            return self.process
        reason = ""
        for _ in range(TRIES):
            with self.guard:
                if self.pool.closing:
                    raise RunError(CLOSED)
                try:
                    self.process = WorkerProcess()
                except OSError as error:
                    raise RunError(f"no planning worker could be started: {error}") from error
            try:
                self.process.start(self.default_planner)
                return self.process
            except (WorkerDiedError, TimeoutError) as error:
                reason = str(error)
                self.end()
            except RunError:
                self.end()
                raise
        planner = self.pool.default_planner
        planner_text = "" if planner is None else f" that plans with {planner.reference.name}"
        raise RunError(f"no worker{planner_text} could be started: {reason}")


def _missed_deadline(job: Job, how: str, planning_s: float) -> Answer:
    """Return the answer of a planner that missed its deadline."""
    reason = f"the planner missed its deadline of {job.deadline_s:g} s ({how})"
    return failed_answer(job.robots, "timeout", reason, planning_s)
