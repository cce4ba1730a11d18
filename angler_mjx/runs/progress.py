"""What a run tells while it goes on."""

from typing import Protocol

from angler_mjx.runs.simulator.compilation import CompileTime


class Progress(Protocol):
    """What a run tells while it goes on."""

    def start(self, worlds: int, done: int) -> None:
        """A run of ``worlds`` begins, ``done`` of them finished before."""

    def compiling(self) -> None:
        """Compilation begins."""

    def compiled(self, compile_time: CompileTime) -> None:
        """Compilation is over."""

    def advance(self, worlds: float, vehicle_steps: int) -> None:
        """A part of the run is done."""

    def tell(self, text: str) -> None:
        """Something that a person should know: what was damaged and is made again."""


class SilentProgress:
    """A progress that says nothing."""

    def start(self, worlds: int, done: int) -> None:
        """See `SampleProgress`."""

    def compiling(self) -> None:
        """See `SampleProgress`."""

    def compiled(self, compile_time: CompileTime) -> None:
        """See `SampleProgress`."""

    def advance(self, worlds: float, vehicle_steps: int) -> None:
        """See `SampleProgress`."""

    def tell(self, text: str) -> None:
        """See `SampleProgress`."""
