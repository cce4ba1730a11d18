"""Progress of a run on the terminal: worlds done, speed, time left."""

from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

if TYPE_CHECKING:
    from angler_mjx.runs.simulator.compilation import CompileTime


class _SpeedColumn(ProgressColumn):
    """Vehicle-steps per second since the simulation began."""

    def render(self, task: Task) -> Text:
        """Return the text of a task."""
        seconds = task.elapsed or 0.0
        steps = task.fields["steps"]
        return Text(f"{steps / seconds:.2e} vehicle-steps/s" if steps and seconds else "")


class ProgressDisplay:
    """Progress display on stderr while entered; its last state stays on the terminal."""

    def __init__(self, *columns: ProgressColumn, quiet: bool = False) -> None:
        """Set up a bar with columns, or no display if ``quiet``."""
        self._bar = Progress(*columns, console=Console(stderr=True, quiet=quiet))

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


class RunBar(ProgressDisplay):
    """A progress bar on stderr; a `runs.progress.Progress`."""

    def __init__(self, *, quiet: bool) -> None:
        """Set up a bar, or no display if ``quiet``."""
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _SpeedColumn(),
            TimeRemainingColumn(),
            quiet=quiet,
        )
        self._worlds = 0
        self._done = 0.0
        self._task = self._bar.add_task("drawing up", total=None, steps=0)

    def start(self, worlds: int, done: int) -> None:
        """See `Progress`."""
        self._worlds, self._done = worlds, float(done)

    def compiling(self) -> None:
        """See `Progress`."""
        self._bar.update(self._task, description="compiling")

    def compiled(self, compile_time: "CompileTime") -> None:
        """See `Progress`."""
        self._bar.console.print(f"compiled in {compile_time.total_s:.1f} s", highlight=False)
        self._bar.reset(
            self._task,
            description="worlds",
            total=self._worlds,
            completed=int(self._done),
            steps=0,
        )

    def advance(self, worlds: float, vehicle_steps: int) -> None:
        """See `Progress`."""
        self._done += worlds
        steps = self._bar.tasks[0].fields["steps"] + vehicle_steps
        self._bar.update(self._task, completed=int(self._done + 1e-6), steps=steps)

    def tell(self, text: str) -> None:
        """See `Progress`."""
        self._bar.console.print(text, highlight=False, markup=False)


class PartsBar(RunBar):
    """A progress bar of several runs in sequence; a `runs.multi_run.RunsProgress`."""

    def __init__(self, *, quiet: bool = False) -> None:
        """Set up a bar, or no display if ``quiet``."""
        super().__init__(quiet=quiet)

    def part(self, number: int, total: int, name: str) -> None:
        """See `RunsProgress`."""
        self._bar.console.print(f"run {number + 1} of {total}: {name}", highlight=False)
        self._bar.reset(self._task, description="drawing up", total=None, steps=0)
