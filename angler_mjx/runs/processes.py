"""Several processes, on one host or more, that share a run: who does what, and who is still there.

They talk through the key-value store of JAX's coordinator. Every process shows a sign of life there
from a thread of its own; one that shows none for a while, or that says it failed, ends the wait of
all others with an error that names it.
"""

import atexit
import json
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, overload

import jax

from angler_mjx.errors import ConfigError, RunError

KEY_ROOT = "angler"
HEARTBEAT_S = 2.0
"""Between two signs of life of a process."""
LOST_AFTER_S = 60.0
"""A process that showed none for this long is taken for dead. A busy host may be slow to answer."""
DISCONNECT_S = 0.5
"""From a process's last word to the end of its connection."""
JOIN_S = 300
"""For all processes to find the coordinator."""


class Processes(Protocol):
    """The processes of a run."""

    index: int
    """Of this process."""
    count: int

    @property
    def stopping(self) -> bool:
        """Whether another process was interrupted, so that this one is to stop as well."""
        ...

    def check(self) -> None:
        """Raise RunError if another process failed or is gone."""
        ...

    @overload
    def meet(self, name: str) -> list[None]: ...
    @overload
    def meet[T](self, name: str, value: T | None) -> list[T]: ...
    def meet(self, name: str, value: object = None) -> Sequence[object]:
        """Wait until every process is here.

        Args:
            name: name of the meeting.
            value: value of this process, written as JSON.

        Returns:
            Values of the processes, in their order; None where a process brings none.
        """
        ...

    def stop(self) -> None:
        """Ask the others to stop after what they are at."""
        ...

    def fail(self, reason: str) -> None:
        """Tell the others that this process cannot go on."""
        ...

    def leave(self) -> None:
        """Go apart after the last meeting; the coordinator goes last."""
        ...


class RunProcesses:
    """Processes that share one run of several, one run after another; see `Processes`.

    What is met for is told apart by the run's name, and nobody leaves at the end of one.
    """

    def __init__(self, processes: Processes, name: str) -> None:
        """The same processes, at one of their runs."""
        self.index, self.count = processes.index, processes.count
        self._all, self._name = processes, name

    @property
    def stopping(self) -> bool:
        """See `Processes`."""
        return self._all.stopping

    def check(self) -> None:
        """See `Processes`."""
        self._all.check()

    @overload
    def meet(self, name: str) -> list[None]: ...
    @overload
    def meet[T](self, name: str, value: T | None) -> list[T]: ...
    def meet(self, name: str, value: object = None) -> Sequence[object]:
        """See `Processes`."""
        return self._all.meet(f"{self._name}/{name}", value)

    def stop(self) -> None:
        """See `Processes`."""
        self._all.stop()

    def fail(self, reason: str) -> None:
        """See `Processes`."""
        self._all.fail(reason)

    def leave(self) -> None:
        """Nothing: the other runs are still to come."""


@contextmanager
def reporting_failure(processes: Processes) -> Iterator[None]:
    """Tell the other processes if this one cannot go on, and part from them."""
    try:
        yield
    except BaseException as error:
        processes.fail(str(error) or type(error).__name__)
        processes.leave()
        raise


class OneProcess:
    """One process alone; see `Processes`."""

    index, count, stopping = 0, 1, False

    def check(self) -> None:
        """See `Processes`."""

    @overload
    def meet(self, name: str) -> list[None]: ...
    @overload
    def meet[T](self, name: str, value: T | None) -> list[T]: ...
    def meet(self, name: str, value: object = None) -> Sequence[object]:
        """See `Processes`."""
        return [value]

    def stop(self) -> None:
        """See `Processes`."""

    def fail(self, reason: str) -> None:
        """See `Processes`."""

    def leave(self) -> None:
        """See `Processes`."""


def join_processes(
    coordinator: str | None = None,
    processes: int | None = None,
    process: int | None = None,
    *,
    gone_s: float = LOST_AFTER_S,
) -> "ManyProcesses":
    """Join the other processes; before JAX computes anything.

    Args:
        coordinator: host and port of process 0, "host:port".
        processes: how many there are.
        process: index of this one. Slurm and Open MPI tell what is left out.
        gone_s: a process that shows no sign of life for this long is taken for dead.

    Raises:
        ConfigError: something was left out that the environment does not tell, or is wrong.
        RunError: the others did not come in time.
    """
    # The others are watched here: JAX would abort them all, with finished worlds unwritten.
    jax.config.update("jax_enable_recoverability", True)
    # It would take SIGTERM for itself, which ends a run cleanly here.
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(coordinator, processes, process, initialization_timeout=JOIN_S)
    except (ValueError, TypeError, IndexError) as error:
        raise ConfigError(
            f"--distributed: {error} Give --coordinator HOST:PORT, --processes N and --process I, "
            "or start under Slurm or Open MPI"
        ) from error
    except RuntimeError as error:
        raise RunError(
            f"--distributed: process {process} of {processes} did not find the others at "
            f"{coordinator} ({str(error).splitlines()[0]})"
        ) from error
    # Every process waits here until all have told each other their devices; after that, one may
    # fail without another one waiting for it inside JAX.
    jax.local_devices()
    return ManyProcesses(_key_value_store(), gone_s)


class KeyValueStore(Protocol):
    """Texts that the processes of a run share, by name."""

    def key_value_set(self, key: str, value: str, allow_overwrite: bool = False) -> None:
        """Store a text."""
        ...

    def key_value_dir_get(self, key: str) -> Sequence[tuple[str, str]]:
        """Return names and texts below a name."""
        ...


def _key_value_store() -> KeyValueStore:
    """Return the key-value store of JAX's coordinator, after `jax.distributed.initialize`.

    JAX gives no public access to it, and no public function replaces it: those of
    `jax.experimental.multihost_utils` are collectives of devices, which wait inside XLA for a
    process that is gone, `live_devices` too. The upper bound of jax in pyproject.toml keeps this
    name; it is imported by shared runs only, so that nothing else depends on it.

    Raises:
        RunError: this version of JAX keeps the store under another name.
    """
    try:
        from jax._src import distributed

        store: KeyValueStore | None = distributed.global_state.client
    except (ImportError, AttributeError) as error:
        raise RunError(
            f"--distributed: jax {jax.__version__} has no jax._src.distributed.global_state.client "
            "(install the version of constraints.txt)"
        ) from error
    if store is None:
        raise RunError("--distributed: jax.distributed.initialize was not called")
    return store


class ManyProcesses:
    """Several processes; see `Processes`."""

    def __init__(self, store: KeyValueStore, gone_s: float) -> None:
        """Begin to show signs of life; see `join_processes`."""
        self.index: int = jax.process_index()
        self.count: int = jax.process_count()
        self._client = store
        self._gone_s = gone_s
        self._last_beats: dict[int, tuple[str, float]] = {}
        self._lost: set[int] = set()
        self._failure: str | None = None
        self._stopping = False
        self._left = threading.Event()
        self._thread = threading.Thread(
            target=self._watch_others, name="angler-processes", daemon=True
        )
        self._thread.start()
        # A thread inside JAX when the interpreter ends would take the process down.
        atexit.register(self._end_watch)

    @property
    def stopping(self) -> bool:
        """See `Processes`."""
        return self._stopping

    def check(self) -> None:
        """See `Processes`."""
        if self._failure is not None:
            raise RunError(
                f"{self._failure}; process {self.index} ends too, finished worlds are kept: go on "
                "with --resume"
            )

    @overload
    def meet(self, name: str) -> list[None]: ...
    @overload
    def meet[T](self, name: str, value: T | None) -> list[T]: ...
    def meet(self, name: str, value: object = None) -> Sequence[object]:
        """See `Processes`."""
        self._client.key_value_set(f"{KEY_ROOT}/{name}/{self.index}", json.dumps(value))
        while True:
            failure = self._failure  # before the values: who came here and then failed was here
            values = self._read_values(name)
            if len(values) == self.count:
                return [json.loads(values[i]) for i in range(self.count)]
            if failure is not None:
                self.check()
            time.sleep(0.05)

    def stop(self) -> None:
        """See `Processes`."""
        self._client.key_value_set(f"{KEY_ROOT}/stop/{self.index}", "", allow_overwrite=True)

    def fail(self, reason: str) -> None:
        """See `Processes`."""
        self._client.key_value_set(f"{KEY_ROOT}/failed/{self.index}", reason, allow_overwrite=True)

    def leave(self) -> None:
        """See `Processes`."""
        self._client.key_value_set(f"{KEY_ROOT}/left/{self.index}", "", allow_overwrite=True)
        if self.index == 0:
            # JAX aborts whoever is still connected when the coordinator ends.
            while len(self._read_values("left").keys() | self._lost) < self.count:
                time.sleep(0.05)
            time.sleep(DISCONNECT_S)
        self._end_watch()
        jax.distributed.shutdown()

    def _end_watch(self) -> None:
        self._left.set()
        self._thread.join()

    def _read_values(self, name: str) -> dict[int, str]:
        """Values under a name by process."""
        try:
            entries = self._client.key_value_dir_get(f"{KEY_ROOT}/{name}/")
        except jax.errors.JaxRuntimeError as error:
            self._failure = f"process 0 cannot be reached ({str(error).splitlines()[0]})"
            self._lost.add(0)
            return {}
        return {int(key.rsplit("/", 1)[1]): value for key, value in entries}

    def _watch_others(self) -> None:
        """Show signs of life and look for those of the others, until this process leaves."""
        beat = 0
        while not self._left.is_set():
            beat += 1
            try:
                self._client.key_value_set(
                    f"{KEY_ROOT}/beat/{self.index}", str(beat), allow_overwrite=True
                )
            except jax.errors.JaxRuntimeError as error:
                self._failure = f"process 0 cannot be reached ({str(error).splitlines()[0]})"
                return
            self._stopping = self._stopping or bool(self._read_values("stop"))
            for other, reason in self._read_values("failed").items():
                self._failure = self._failure or f"process {other} failed: {reason}"
            self._find_lost_processes(self._read_values("beat"))
            self._left.wait(min(HEARTBEAT_S, self._gone_s / 4))

    def _find_lost_processes(self, beats: dict[int, str]) -> None:
        """Note who showed a new sign of life, and who has not for too long."""
        now = time.monotonic()
        for other in range(self.count):
            beat = beats.get(other, "")
            last_beat, seen_s = self._last_beats.get(other, ("", now))
            self._last_beats[other] = (beat, now if beat != last_beat else seen_s)
            if now - self._last_beats[other][1] > self._gone_s:
                self._lost.add(other)
                self._failure = self._failure or (
                    f"process {other} is gone: no sign of life for {self._gone_s:g} s"
                )
