"""A worker process and the pipes to it, from its start to its end."""

import contextlib
import math
import os
import signal
import subprocess
import sys
from multiprocessing.connection import Pipe
from typing import Any

from angler_mjx.errors import RunError

START_S = 300.0
"""Time limit [s] of a start, with imports and making of the planner; and of a warm-up."""

SINGLE_THREAD_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}
"""Environment of a worker; XLA has `XLA_SINGLE_THREAD` among its flags."""

XLA_SINGLE_THREAD = "--xla_cpu_multi_thread_eigen=false"

_PROGRAM = (
    "import sys; from angler_mjx.planning.host.worker import main; main(*map(int, sys.argv[1:]))"
)


class WorkerDiedError(Exception):
    """A worker process ended; the text is its exit code or signal."""


class WorkerProcess:
    """A worker process and the pipes to it."""

    def __init__(self) -> None:
        self._wire, worker_end = Pipe(duplex=True)
        watched, self._alive = os.pipe()
        arguments = [str(worker_end.fileno()), str(watched)]
        with worker_end:
            self._popen = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, *arguments],
                env=_worker_environment(),
                stdin=subprocess.DEVNULL,
                stdout=2,
                pass_fds=(worker_end.fileno(), watched),
                start_new_session=True,
            )
        os.close(watched)
        self.pid = self._popen.pid

    def start(self, made_of: bytes) -> None:
        """Send the pool's own planner and wait until it is made.

        Args:
            made_of: a pickled `PlannerSpec`, or pickled None.

        Raises:
            RunError: the planner cannot be made.
            TimeoutError: the process was not ready in time.
            WorkerDiedError: the process ended.
        """
        self.send(made_of)
        try:
            self.receive("ready", START_S)
        except TimeoutError:
            raise TimeoutError(f"it was not ready after {START_S:g} s") from None

    def send(self, sent: bytes) -> None:
        """Send pickled bytes.

        Raises:
            WorkerDiedError: the process ended.
        """
        try:
            self._wire.send_bytes(sent)
        except OSError as error:
            raise WorkerDiedError(self._exit_reason()) from error

    def receive(self, expected: str, within_s: float) -> tuple[Any, ...]:
        """Wait for a message and return what follows its word.

        Args:
            expected: word of the message.
            within_s: time limit, s.

        Raises:
            TimeoutError: no message came in time.
            RunError: the planner cannot be made, or the message has another word.
            WorkerDiedError: the process ended.
        """
        try:
            if not self._wire.poll(within_s if math.isfinite(within_s) else None):
                raise TimeoutError
            received, *rest = self._wire.recv()
        except TimeoutError:
            raise
        except (EOFError, OSError) as error:
            raise WorkerDiedError(self._exit_reason()) from error
        if received == "cannot":
            raise RunError(f"the planner cannot be made: {rest[0]}")
        if received != expected:
            raise RunError(f"a planning worker said {received!r} where {expected!r} was to come")
        return tuple(rest)

    def kill(self) -> None:
        """End the process and the processes that it started."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)

    def end(self) -> None:
        """End the process, wait for its end, and close the pipes."""
        if self._popen.poll() is None:
            self.kill()
        self._popen.wait()
        self._wire.close()
        os.close(self._alive)

    def _exit_reason(self) -> str:
        """Return the exit code or the signal of the process."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._popen.wait(timeout=1.0)
            if code >= 0:
                return f"exit code {code}"
            return signal.Signals(-code).name
        return "it closed its pipe"


def _worker_environment() -> dict[str, str]:
    """Return the environment of a worker: this process's, with one thread and its module path."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {XLA_SINGLE_THREAD}".strip()
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    return {**os.environ, **SINGLE_THREAD_ENVIRONMENT, "XLA_FLAGS": flags, "PYTHONPATH": path}
