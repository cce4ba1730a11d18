"""Processes that plan on many machines: a Ray cluster that somebody started.

Needs the extra ``ray``. See "Many planners, many machines" in docs/planners.md.
"""

import pickle

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.cluster.connection import Cluster
from angler_mjx.planning.host.cluster.runner import ActorRunner
from angler_mjx.planning.host.processes.queued_pool import QueuedPool
from angler_mjx.planning.register import PlannerSpec


class RayWorkers(QueuedPool):
    """A `pool.Pool` of actors on a Ray cluster, each with a processor and `Workers` of one process.

    So deadlines, and what becomes of planners that do not keep them or die, are those of `Workers`,
    and the same problems have the same plans. An actor or a machine that dies costs the problem
    that it has: it is planned again elsewhere, once.

    A planner of a file takes the file along. What the file imports from its own folder has to lie
    there, at the same path, on all machines.
    """

    def __init__(
        self, address: str, count: int | None = None, planner: PlannerSpec | None = None
    ) -> None:
        """Joins the cluster and begins the actors; does not wait for them.

        Args:
            address: HOST:PORT of the cluster's head; this machine has to be in the cluster.
            count: actors; one for each processor of the cluster where left out.
            planner: who plans where no planner is given; as of `Workers`.

        Raises:
            ConfigError: nobody answers there; the machines have other versions installed; or there
                are fewer processors.
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

    def pack(self, planner: PlannerSpec) -> bytes:
        """As `QueuedPool.pack`."""
        return pickle.dumps(planner)

    def pids(self) -> list[int]:
        """Process ids of the actors that are up, each on its machine."""
        return [runner.pid for runner in self._actors if runner.pid is not None]

    def close(self) -> None:
        """Ends all actors, waits for their end, and leaves the cluster."""
        try:
            super().close()
        finally:
            self._cluster.leave()
