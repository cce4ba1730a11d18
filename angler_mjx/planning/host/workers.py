"""Processes that plan: what a planner does there harms nobody but its own problem.

Each has one thread and plans one problem at a time. One that takes too long is killed, one that
dies is replaced, and the pool goes on. All end with the process that made them, however that ends.
"""

import pickle

from angler_mjx.planning.host.processes.queued_pool import QueuedPool
from angler_mjx.planning.host.processes.runner import ProcessRunner
from angler_mjx.planning.register import PlannerSpec


class Workers(QueuedPool):
    """A `pool.Pool` of processes on this machine.

    Problems are answered in any order, and may be handed in while others are planned. A process
    makes a planner when it first meets it, and keeps it: all that it keeps share its memory and
    its imports. A planner that has a method ``warm_up(problem)`` is given its process's first
    problem there before the clock starts, to compile; ``extras`` of a planner (names and numbers of
    its last plan) stand in the answer.

    An answer's planner took at most 1.1 times the problem's deadline: what came later is not
    believed, and half a second after that its process is killed. A problem whose process dies is
    planned again, once, as somebody else may have killed it.
    """

    def __init__(self, make: PlannerSpec | None, count: int) -> None:
        """Starts the processes; does not wait for them.

        Args:
            make: who plans where no planner is given; made at once. That it cannot be made is a
                RunError to whoever waits. None: a planner is given with each problem.
            count: processes, at least 1. Each imports JAX, though only a planner that computes
                with it starts it: some 3 s and 200 MB where nothing else is imported.

        Raises:
            ConfigError: there is no worker.
        """
        super().__init__(make, count)
        self._processes = [ProcessRunner(self) for _ in range(count)]
        self.begin(self._processes)

    def pack(self, planner: PlannerSpec) -> bytes:
        """As `QueuedPool.pack`."""
        return pickle.dumps(planner)

    def pids(self) -> list[int]:
        """Process ids of the workers that live now."""
        return [pid for runner in self._processes if (pid := runner.pid()) is not None]
