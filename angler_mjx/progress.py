"""Progress of long work: how much is done of how much, and lines for a person."""

from angler_mjx._moved import renamed as _renamed


class Progress:
    """Receiver of progress that ignores everything; subclasses override what they show."""

    def start(self, total: int, done: int = 0, unit: str = "worlds") -> None:
        """Begin work.

        Args:
            total: amount of all work, including what was finished before.
            done: amount finished before.
            unit: noun of the amount, in the plural.
        """

    def describe(self, text: str) -> None:
        """Replace the description of the step that is being done."""

    def advance(self, amount: float, vehicle_steps: int = 0) -> None:
        """Add finished work.

        Args:
            amount: in the unit of `start`; parts of one count.
            vehicle_steps: simulated for it.
        """

    def report(self, text: str) -> None:
        """Show a line that stays, such as a repair, a warning or an intermediate result."""


def __getattr__(name: str) -> object:
    """Return a class by its name of 0.1."""
    return _renamed(__name__, name)
