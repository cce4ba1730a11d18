"""One worker process, the pipes to it, and its end."""

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
"""For a process to start, import and make its planner; and for a planner to warm up."""

SINGLE_THREAD_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}
"""Environment of a worker; XLA is told by its flags."""

XLA_SINGLE_THREAD = "--xla_cpu_multi_thread_eigen=false"

_PROGRAM = (
    "import sys; from angler_mjx.planning.host.worker import main; main(*map(int, sys.argv[1:]))"
)


class WorkerDiedError(Exception):
    """A worker is gone; its text says how."""


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
        """Has it make its pool's own planner; waits for it.

        Args:
            made_of: a pickled `PlannerSpec`, or None for no planner.

        Raises:
            RunError: the planner cannot be made.
            TimeoutError: nothing came in time.
            DiedError: the process is gone.
        """
        self.send(made_of)
        try:
            self.receive("ready", START_S)
        except TimeoutError:
            raise TimeoutError(f"it was not ready after {START_S:g} s") from None

    def send(self, sent: bytes) -> None:
        """Hands something pickled down.

        Raises:
            DiedError: the process is gone.
        """
        try:
            self._wire.send_bytes(sent)
        except OSError as error:
            raise WorkerDiedError(self._exit_reason()) from error

    def receive(self, expected: str, within_s: float) -> tuple[Any, ...]:
        """What comes after a word.

        Raises:
            TimeoutError: it did not come.
            RunError: the planner cannot be made.
            DiedError: the process is gone.
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
        """Ends it and what it started."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)

    def end(self) -> None:
        """Ends it, and leaves nothing of it."""
        if self._popen.poll() is None:
            self.kill()
        self._popen.wait()
        self._wire.close()
        os.close(self._alive)

    def _exit_reason(self) -> str:
        """How it ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._popen.wait(timeout=1.0)
            if code >= 0:
                return f"exit code {code}"
            return signal.Signals(-code).name
        return "it closed its pipe"


def _worker_environment() -> dict[str, str]:
    """Of a worker: this process's, one thread, and the same modules."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {XLA_SINGLE_THREAD}".strip()
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    return {**os.environ, **SINGLE_THREAD_ENVIRONMENT, "XLA_FLAGS": flags, "PYTHONPATH": path}
