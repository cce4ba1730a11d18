"""Parallel processes for checks, each computed on the device and on the CPU, then compared."""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from angler_mjx.files import JsonTable
from tools.gpu_check.checks import CHECKS, TESTS
from tools.gpu_check.comparing import compare_arrays

ROOT = Path(__file__).parents[2]
REFERENCE_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_disable_new_fusion_emitters "
    "--xla_backend_optimization_level=1"
)
"""XLA flags of the CPU's programs: they compile in a third of the time."""


@dataclass(frozen=True, kw_only=True)
class CheckOutcome:
    """Result of one check."""

    name: str
    status: str
    """passed, failed, slower, skipped, or unfinished at the deadline."""
    seconds: float
    reason: str = ""
    row: JsonTable = field(default_factory=dict)
    """Row of a rate."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Machine of the checks."""

    device: str
    """gpu or cpu."""
    cache: Path
    """Folder of compiled programs, shared by all processes."""
    deadline: float
    """Time of `time.monotonic` at which running processes are ended."""

    def start_module(
        self, module: Sequence[str], platform: str, log: Path
    ) -> subprocess.Popen[bytes]:
        """Start a Python module on one platform, its output in a file."""
        with log.open("wb") as file:
            return subprocess.Popen(
                [sys.executable, "-m", *module],
                cwd=ROOT,
                env=self._environment(platform),
                stdout=file,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
            )

    def _environment(self, platform: str) -> dict[str, str]:
        paths = [ROOT, *(ROOT / name for name in ("kernels", "sitl_bridge", "experiments"))]
        inherited = [path for path in [os.environ.get("PYTHONPATH")] if path]
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([*map(str, paths), *inherited]),
            "JAX_PLATFORMS": "cpu" if platform == "cpu" else "cuda",
            "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
            "JAX_COMPILATION_CACHE_DIR": str(self.cache),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
            "TF_CPP_MIN_LOG_LEVEL": "1",
        }
        if platform == "cpu":
            environment["XLA_FLAGS"] = REFERENCE_FLAGS
        return environment

    def wait_for(self, process: subprocess.Popen[bytes]) -> bool:
        """Wait for a process; return whether it ended before the deadline."""
        try:
            process.wait(max(0.0, self.deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return False
        return True


def run_work(machine: Machine, name: str, platform: str, out: Path) -> str | None:
    """Run `tools.gpu_check.work` to its end.

    Returns:
        Empty after success, None after the deadline, else the last lines of its output.
    """
    log = out.with_suffix(".log")
    process = machine.start_module(["tools.gpu_check.work", name, str(out)], platform, log)
    if not machine.wait_for(process):
        return None
    return "" if process.returncode == 0 else _last_lines(log, process.returncode)


def run_check(machine: Machine, name: str) -> CheckOutcome:
    """Compute one check on both platforms at once, and compare."""
    start_s, check = time.monotonic(), CHECKS[name]

    def build_outcome(status: str, reason: str = "") -> CheckOutcome:
        seconds = round(time.monotonic() - start_s, 1)
        return CheckOutcome(name=name, status=status, seconds=seconds, reason=reason)

    if missing := [package for package in check.needs if not importlib.util.find_spec(package)]:
        return build_outcome("skipped", f"{', '.join(missing)} is not installed")
    with tempfile.TemporaryDirectory() as folder:
        outs = {"device": Path(folder, "device.npz"), "cpu": Path(folder, "cpu.npz")}
        platforms = {"device": machine.device, "cpu": "cpu"}
        if not check.compared:
            del outs["cpu"]
        with ThreadPoolExecutor(len(outs)) as pool:
            futures = {
                side: pool.submit(run_work, machine, name, platforms[side], out)
                for side, out in outs.items()
            }
        messages = {side: future.result() for side, future in futures.items()}
        if any(message for message in messages.values()):
            return build_outcome(
                "failed", "; ".join(f"{s}: {message}" for s, message in messages.items() if message)
            )
        if None in messages.values():
            return build_outcome("unfinished", "time was up")
        arrays = {side: dict(np.load(out)) for side, out in outs.items()}
    if not check.compared:
        return build_outcome("passed")
    faults, notes = compare_arrays(arrays["device"], arrays["cpu"], check.bounds)
    return build_outcome("failed" if faults else "passed", "; ".join(faults or notes))


def run_tests(machine: Machine) -> CheckOutcome:
    """Run the tests that are marked for a GPU."""
    start_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder, "pytest.log")
        arguments = [
            "pytest",
            "-q",
            "--tb=line",
            "-m",
            "gpu",
            "-p",
            "no:cacheprovider",
            "tests/angler_mjx/sim/engines",
        ]
        process = machine.start_module(arguments, machine.device, log)
        in_time = machine.wait_for(process)
        text = _last_lines(log, process.returncode)
    seconds = round(time.monotonic() - start_s, 1)
    if not in_time:
        return CheckOutcome(name=TESTS, status="unfinished", seconds=seconds, reason="time was up")
    status, reason = judge_tests(process.returncode, text)
    return CheckOutcome(name=TESTS, status=status, seconds=seconds, reason=reason)


def judge_tests(code: int, text: str) -> tuple[str, str]:
    """Return a status and its reason: of failed tests pytest's last lines.

    Args:
        code: exit status of pytest.
        text: last lines of its output, with the short summary of ``-ra``.
    """
    if code != 0:
        return "failed", text
    last = text.splitlines()[-1]
    return ("passed" if " passed" in last else "skipped"), last


def run_side_by_side(
    machine: Machine, names: Sequence[str], jobs: int, report: Callable[[CheckOutcome], None]
) -> None:
    """Run checks in ``jobs`` parallel processes; none begins after the deadline.

    Args:
        machine: machine of the checks.
        names: names of checks in the order of starting.
        jobs: processes, two of each check.
        report: called with each outcome, from this thread.
    """
    waiting = list(names)
    with ThreadPoolExecutor(max(1, jobs // 2)) as pool:
        running: set[Future[CheckOutcome]] = set()
        while running or waiting:
            while waiting and len(running) < max(1, jobs // 2):
                if time.monotonic() >= machine.deadline:
                    waiting.clear()
                    break
                name = waiting.pop(0)
                call = run_tests if name == TESTS else None
                running.add(
                    pool.submit(call, machine) if call else pool.submit(run_check, machine, name)
                )
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                report(future.result())


def run_rate(machine: Machine, name: str, reference: JsonTable | None) -> CheckOutcome:
    """Measure the rate of a workload alone, and judge it by the stored row."""
    from tools.gpu_check.workloads import judge_rate

    start_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "row.json")
        text = run_work(machine, name, machine.device, out)
        row = json.loads(out.read_text()) if text == "" else {}
    seconds = round(time.monotonic() - start_s, 1)
    if text is None:
        return CheckOutcome(name=name, status="unfinished", seconds=seconds, reason="time was up")
    if text:
        return CheckOutcome(name=name, status="failed", seconds=seconds, reason=text)
    status, reason = judge_rate(row, dict(reference) if reference else None)
    return CheckOutcome(name=name, status=status, seconds=seconds, reason=reason, row=row)


def _last_lines(log: Path, code: int) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return "\n".join(lines[-12:]) or f"exit status {code}, and nothing printed"
