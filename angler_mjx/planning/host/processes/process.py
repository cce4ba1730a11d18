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

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
}
"""Environment of a worker; XLA is told by its flags."""

XLA_ONE_THREAD = "--xla_cpu_multi_thread_eigen=false"

_PROGRAM = (
    "import sys; from angler_mjx.planning.host.worker import main; main(*map(int, sys.argv[1:]))"
)


class DiedError(Exception):
    """A worker is gone; its text says how."""


class WorkerProcess:
    """A worker process and the pipes to it."""

    def __init__(self) -> None:
        self._wire, theirs = Pipe(duplex=True)
        watched, self._alive = os.pipe()
        inside = [str(theirs.fileno()), str(watched)]
        with theirs:
            self._popen = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, *inside],
                env=_environment(),
                stdin=subprocess.DEVNULL,
                stdout=2,
                pass_fds=(theirs.fileno(), watched),
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
            raise DiedError(self._how()) from error

    def receive(self, word: str, within_s: float) -> tuple[Any, ...]:
        """What comes after a word.

        Raises:
            TimeoutError: it did not come.
            RunError: the planner cannot be made.
            DiedError: the process is gone.
        """
        try:
            if not self._wire.poll(within_s if math.isfinite(within_s) else None):
                raise TimeoutError
            came, *rest = self._wire.recv()
        except TimeoutError:
            raise
        except (EOFError, OSError) as error:
            raise DiedError(self._how()) from error
        if came == "cannot":
            raise RunError(f"the planner cannot be made: {rest[0]}")
        if came != word:
            raise RunError(f"a planning worker said {came!r} where {word!r} was to come")
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

    def _how(self) -> str:
        """How it ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._popen.wait(timeout=1.0)
            if code >= 0:
                return f"exit code {code}"
            return signal.Signals(-code).name
        return "it closed its pipe"


def _environment() -> dict[str, str]:
    """Of a worker: this process's, one thread, and the same modules."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {XLA_ONE_THREAD}".strip()
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    return {**os.environ, **ONE_THREAD, "XLA_FLAGS": flags, "PYTHONPATH": path}
