"""Copies of the tree for workers, and pytest in one of them."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.mutants.pytest_plugin import CORES
from tools.mutants.relevance import SOURCES

_IGNORED_ANYWHERE = {"__pycache__"}
_IGNORED_AT_TOP = {".git", ".venv", ".cache", ".hypothesis", ".mutants", "build", "dist", "runs"}
_FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.M)
_NO_TESTS = 5
_OPTIONS = (
    *("-x", "-q", "-n", "0", "--tb=no", "-m", "not gpu and not sitl"),
    *("-p", "no:cacheprovider", "-p", "tools.mutants.pytest_plugin"),
)


@dataclass(frozen=True, kw_only=True)
class PytestRun:
    """Run of pytest."""

    code: int | None
    """Exit status; None where it was stopped."""
    seconds: float
    failed: str
    """Test that failed first, or the last lines where no test could begin."""

    @property
    def has_passed(self) -> bool:
        """Return whether nothing failed; a run with all tests skipped passes."""
        return self.code in (0, _NO_TESTS)


class StoppedError(RuntimeError):
    """Interruption of the tests from outside: they have no result."""


class WorkerTree:
    """Copy of the tree for one worker.

    Files are compiled once, and Python checks them by their contents: a file that is changed twice
    within the clock's resolution is still read anew.
    """

    def __init__(self, root: Path, copy: Path, xla: Path, cores: Sequence[int]) -> None:
        """Copy a tree.

        Args:
            root: tree to copy.
            copy: target folder; its contents are replaced.
            xla: folder of compiled programs, shared by all copies.
            cores: processors for the tests.
        """
        self.root = copy
        self._running: subprocess.Popen[str] | None = None
        self._stopped = False
        shutil.rmtree(copy, ignore_errors=True)

        def ignored_names(folder: str, names: list[str]) -> set[str]:
            ignored_at_top = _IGNORED_AT_TOP if Path(folder) == root else set[str]()
            return (_IGNORED_ANYWHERE | ignored_at_top) & set(names)

        shutil.copytree(root, copy, ignore=ignored_names, symlinks=True)
        # The copy before the rest of the path, which may hold the tree itself.
        path = [*(str(copy / source) for source in SOURCES), os.environ.get("PYTHONPATH", "")]
        self._environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(filter(None, path)),
            "PYTHONDONTWRITEBYTECODE": "1",
            "JAX_PLATFORMS": "cpu",
            "JAX_COMPILATION_CACHE_DIR": str(xla),
            "XDG_CACHE_HOME": str(copy / ".cache"),
            CORES: ",".join(map(str, cores)),
            "CI": "true",
        }
        packages = [str(copy / name) for name in ("angler_mjx", *SOURCES[1:], "tests")]
        check = ["--invalidation-mode", "checked-hash"]
        subprocess.run([sys.executable, "-m", "compileall", "-q", *check, *packages], check=True)

    @contextlib.contextmanager
    def replace_file(self, file: str, code: str) -> Iterator[None]:
        """Replace the text of a file within the context."""
        path = self.root / file
        before = path.read_bytes()
        path.write_text(code)
        try:
            yield
        finally:
            path.write_bytes(before)

    def run_tests(self, files: Sequence[str], limit_s: float) -> PytestRun:
        """Run test files in this order, up to the first failure.

        Args:
            files: paths from the root.
            limit_s: wall time after which it is stopped.

        Raises:
            StoppedError: `stop` was called.
        """
        began = time.monotonic()
        with subprocess.Popen(
            [sys.executable, "-m", "pytest", *_OPTIONS, *files],
            cwd=self.root,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as process:
            self._running = process
            try:
                output, _ = process.communicate(timeout=limit_s)
                code: int | None = process.returncode
            except subprocess.TimeoutExpired:
                output, code = "", None
            finally:
                self._running = None
                _kill_group(process)
        if self._stopped:
            raise StoppedError("stopped while tests ran")
        match = _FAILED.search(output)
        first_failure = match[1] if match else output.strip()[-300:]
        return PytestRun(
            code=code, seconds=round(time.monotonic() - began, 2), failed=first_failure
        )

    def stop(self) -> None:
        """End the running tests and start no more; called from another thread."""
        self._stopped = True
        process = self._running
        if process is not None:
            _kill_group(process)


def _kill_group(process: subprocess.Popen[str]) -> None:
    """End pytest and the processes that its tests started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
