"""Tests and studies as separate processes, with their results."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from angler_mjx.errors import RunError
from angler_mjx.testing.validation import results
from angler_mjx.testing.validation.results import MeasuredDeviations, TermResult
from angler_mjx.testing.validation.terms import StudyTerm

TEST_XLA_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_disable_new_fusion_emitters "
    "--xla_backend_optimization_level=0"
)
"""XLA flags of ``make test``: most of the tests' time is XLA's."""

REPORT_PERIOD_S = 20.0
"""Time between progress lines."""

type Report = Callable[[str], None]


def run_tests(
    root: Path, tests: Sequence[str], report: Report
) -> tuple[MeasuredDeviations, list[str]]:
    """Run the named tests and read their measurements.

    Args:
        root: of the checkout.
        tests: arguments of pytest.
        report: receives a line of progress.

    Returns:
        The measurements, and the failed tests.

    Raises:
        RunError: pytest could not run them.
    """
    files = len({test.partition("::")[0] for test in tests})
    report(f"tests: {len(tests)} of {files} files")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "deviations.json"
        command = [sys.executable, "-m", "pytest", "-q", "-rfE", "--no-header", "--tb=short"]
        command += ["--deviations", str(out), "-m", "nightly or not nightly"]
        command += [*_parallel_options(), *tests]
        output, code = _run_process(command, root, {"XLA_FLAGS": TEST_XLA_FLAGS}, report, "tests")
        if code not in (0, 1) or not out.is_file():
            raise RunError(f"pytest ended with {code}; its last words:\n{_last_lines(output)}")
        failed = [line.split(" - ")[0] for line in output if line.startswith(("FAILED ", "ERROR "))]
        return results.read_model(MeasuredDeviations, out), failed


def run_study(root: Path, study: StudyTerm, arguments: Sequence[str], report: Report) -> TermResult:
    """Run a program and read its result.

    Raises:
        RunError: it failed.
    """
    report(f"{study.name}: python -m {' '.join([study.module, *arguments])}")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result.json"
        command = [sys.executable, "-m", study.module, *arguments, "--json", str(out)]
        output, code = _run_process(command, root, {}, report, study.name)
        if code != 0 or not out.is_file():
            raise RunError(
                f"{study.module} ended with {code}; its last words:\n{_last_lines(output)}"
            )
        return results.read_model(TermResult, out)


def _parallel_options() -> list[str]:
    """Return the options for two processes where there are two cores."""
    return ["-n", "2", "--dist", "loadfile"] if (os.cpu_count() or 1) > 1 else []


def _run_process(
    command: Sequence[str], root: Path, defaults: dict[str, str], report: Report, name: str
) -> tuple[list[str], int]:
    """Return lines and exit status of a process, with progress every ``REPORT_PERIOD_S``.

    Progress is needed also for a silent process: a study compiles for minutes before its first
    line.
    """
    # Without a terminal pytest-xdist prints in blocks; its last output is read at the end.
    environment = {**defaults, **os.environ, "PYTHONUNBUFFERED": "1"}
    start_s, done = time.monotonic(), threading.Event()
    lines = list[str]()

    def report_progress() -> None:
        while not done.wait(REPORT_PERIOD_S):
            last_line = f", {lines[-1][-60:]}" if lines else ""
            report(f"{name}: {time.monotonic() - start_s:.0f} s{last_line}")

    with subprocess.Popen(
        command,
        cwd=root,
        env=environment,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as process:
        assert process.stdout is not None
        reporter = threading.Thread(target=report_progress, daemon=True)
        reporter.start()
        try:
            lines.extend(line.rstrip("\n") for line in process.stdout)
        finally:
            done.set()
            reporter.join()
    report(f"{name}: done after {time.monotonic() - start_s:.0f} s")
    return lines, process.returncode


def _last_lines(lines: Sequence[str]) -> str:
    return "\n".join(lines[-15:])
