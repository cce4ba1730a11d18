"""What plans many problems at once, wherever its processes are."""

from collections.abc import Iterable, Iterator
from typing import Protocol, Self

from angler_mjx.planning.answers import Answer
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerSpec


class Pool(Protocol):
    """Plans in processes: `workers.Workers` on this machine, `cluster.ray_workers` on many.

    Use it in a ``with`` statement: on leaving it, by an exception too, its processes are gone.
    """

    @property
    def count(self) -> int:
        """Problems that are planned at the same time."""
        ...

    def submit(self, problem: Problem, planner: PlannerSpec | None = None) -> int:
        """Hands a problem in.

        Args:
            problem: arrays of NumPy, or of JAX, which are fetched.
            planner: who plans it; the pool's own where left out. One that cannot be made is this
                problem's answer: status ``error``, and why.

        Returns:
            The ticket of its answer.

        Raises:
            ConfigError: no planner is given, and the pool has none of its own.
            RunError: the pool is closed, or cannot plan.
        """
        ...

    def take(self, ticket: int) -> Answer:
        """The answer to a problem, once; waits for it.

        Raises:
            RunError: the pool is closed or cannot plan; or the ticket was taken before.
        """
        ...

    def completed(
        self, tickets: Iterable[int], ahead: int | None = None
    ) -> Iterator[tuple[int, Answer]]:
        """Tickets and their answers as they come, whatever the order; each is taken by it.

        Args:
            tickets: may be a generator that hands problems in.
            ahead: tickets that are drawn and not answered; left out: all are drawn at once.

        Raises:
            RunError: as `take`.
        """
        ...

    def close(self) -> None:
        """Ends all processes and waits for their end; problems that are not answered are lost."""
        ...

    def __enter__(self) -> Self:
        """Itself."""
        ...

    def __exit__(self, *why: object) -> None:
        """Closes."""
        ...
