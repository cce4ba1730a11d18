"""Progress bar on stderr: the one implementation of `angler_mjx.progress.Progress` for people."""

from types import TracebackType
from typing import Self

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichProgress
from rich.text import Text

from angler_mjx.cli.shared.consoles import make_progress_console
from angler_mjx.progress import Progress


class _SpeedColumn(ProgressColumn):
    """Vehicle-steps per second since the work began."""

    def render(self, task: Task) -> Text:
        """Return the text of a task."""
        seconds = task.elapsed or 0.0
        steps = task.fields["steps"]
        return Text(f"{steps / seconds:.2e} vehicle-steps/s" if steps and seconds else "")


class ProgressBar(Progress):
    """Progress bar on stderr while entered; its last state stays on the terminal."""

    def __init__(self, description: str = "setting up", *, quiet: bool = False) -> None:
        """Set up a bar, or no display if ``quiet``.

        Args:
            description: of the first step.
            quiet: whether nothing is shown.
        """
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[unit]}"),
            _SpeedColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=make_progress_console(quiet=quiet),
        )
        self._done = self._done_before = 0.0
        self._task = self._bar.add_task(description, total=None, steps=0, unit="")

    def __enter__(self) -> Self:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the bar as it is."""
        self._bar.stop()

    def start(self, total: int, done: int = 0, unit: str = "worlds") -> None:
        """See `Progress`."""
        self._done = self._done_before = float(done)
        self._bar.reset(self._task, description="", total=total, completed=done, steps=0, unit=unit)

    def describe(self, text: str) -> None:
        """See `Progress`; times count from the last step without any work."""
        task = self._bar.tasks[0]
        if self._done == self._done_before:
            self._bar.reset(self._task, total=task.total, completed=int(self._done))
        self._bar.update(self._task, description=text)
        if not self._bar.console.is_terminal:
            self.report(text)

    def advance(self, amount: float, vehicle_steps: int = 0) -> None:
        """See `Progress`."""
        self._done += amount
        steps = self._bar.tasks[0].fields["steps"] + vehicle_steps
        self._bar.update(self._task, completed=int(self._done + 1e-6), steps=steps)

    def report(self, text: str) -> None:
        """See `Progress`."""
        self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
