"""What a run tells while it goes on."""

from typing import Protocol

from angler_mjx.runs.simulator.compiling import CompileTime


class Progress(Protocol):
    """What a run tells while it goes on."""

    def start(self, worlds: int, done: int) -> None:
        """A run of ``worlds`` begins, ``done`` of them finished before."""

    def compiling(self) -> None:
        """Compilation begins."""

    def compiled(self, took: CompileTime) -> None:
        """Compilation is over."""

    def advance(self, worlds: float, vehicle_steps: int) -> None:
        """A part of the run is done."""

    def tell(self, text: str) -> None:
        """Something that a person should know: what was damaged and is made again."""


class SilentProgress:
    """A progress that says nothing."""

    def start(self, worlds: int, done: int) -> None:
        """See `Progress`."""

    def compiling(self) -> None:
        """See `Progress`."""

    def compiled(self, took: CompileTime) -> None:
        """See `Progress`."""

    def advance(self, worlds: float, vehicle_steps: int) -> None:
        """See `Progress`."""

    def tell(self, text: str) -> None:
        """See `Progress`."""
