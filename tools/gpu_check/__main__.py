"""``python -m tools.gpu_check``: check a machine with a GPU, in parts that resume."""

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import tyro

from tools.gpu_check import checks, running, workloads
from tools.gpu_check.running import CheckOutcome, Machine

ROW_FIELDS = (
    "worlds",
    "robots",
    "unit",
    "engine",
    "kernels",
    "median",
    "low",
    "high",
    *workloads.HOST,
)
"""Fields of a row that are stored."""


@dataclass(frozen=True, kw_only=True)
class GpuCheckOptions:
    """Compare engines, kernels, policies, planners and rates of a GPU with the CPU's outcomes.

    A call ends after --minutes; the next one continues with the remaining checks.
    """

    device: Literal["gpu", "cpu"] = "gpu"
    """Device under test; cpu tries the script itself, in small."""
    minutes: float = 8.0
    """Minutes after which processes are ended and their checks are left to the next call."""
    jobs: int = min(16, os.cpu_count() or 1)
    """Parallel processes; rates are measured alone."""
    only: tuple[str, ...] = ()
    """Prefixes of the names of checks to run; all if left out."""
    results: Path = running.ROOT / ".cache" / "gpu_check.jsonl"
    """File of outcomes, one per line; those of another commit or device are ignored."""
    again: bool = False
    """Run once more the checks that failed, were slower or were skipped."""
    fresh: bool = False
    """Forget all outcomes of this commit and device."""
    list: bool = False
    """Only list the checks and the known outcome of each."""
    store: bool = False
    """Store the measured rates as medians of this card, with date and commit."""


def main(options: GpuCheckOptions) -> int:
    """Run checks; return 0 if all chosen ones passed or were skipped, 3 if some remain."""
    cache = running.ROOT / ".cache" / "gpu_check_programs"
    cache.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + 60.0 * options.minutes
    machine = Machine(device=options.device, cache=cache, deadline=deadline)
    about = _describe_device(machine)
    mark = [about["commit"], about["device"], options.device]
    chosen = [n for n in checks.list_checks() if not options.only or n.startswith(options.only)]
    if not chosen:
        print(f"--only {' '.join(options.only)}: no check begins so", file=sys.stderr)
        return 2
    if options.fresh:
        options.results.unlink(missing_ok=True)
    outcomes = _read_outcomes(options.results, mark)
    done = {
        name: outcome
        for name, outcome in outcomes.items()
        if outcome.status == "passed" or (outcome.status != "unfinished" and not options.again)
    }
    if options.list:
        for name in chosen:
            print(name, outcomes[name].status if name in outcomes else "")
        return 0
    start_s = time.monotonic()

    def report(outcome: CheckOutcome) -> None:
        outcomes[outcome.name] = outcome
        line = {**asdict(outcome), "mark": mark, "at_utc": datetime.now(UTC).isoformat()}
        options.results.parent.mkdir(parents=True, exist_ok=True)
        with options.results.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(
            f"[{time.monotonic() - start_s:5.0f} s] {outcome.status:10} {outcome.name} "
            f"({outcome.seconds:.0f} s) {outcome.reason}",
            flush=True,
        )

    remaining = [name for name in chosen if name not in done]
    side_by_side = [name for name in remaining if name not in checks.RATES]
    running.run_side_by_side(machine, side_by_side, options.jobs, report)
    _run_rates(
        machine, [name for name in remaining if name in checks.RATES], about["device"], report
    )
    if options.store:
        _store_medians(outcomes, about)
    return _print_summary(chosen, outcomes, about)


def _describe_device(machine: Machine) -> dict[str, Any]:
    """Describe the device in a separate process, so that this one holds no device memory."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "about.json")
        if text := running.run_work(machine, "about", machine.device, out):
            raise SystemExit(f"device {machine.device!r} cannot be checked here:\n{text}")
        if not out.is_file():
            raise SystemExit("time was up before the device answered: give more --minutes")
        description: dict[str, Any] = json.loads(out.read_text())
    return description


def _run_rates(
    machine: Machine, names: list[str], device: str, report: Callable[[CheckOutcome], None]
) -> None:
    medians = workloads.read_medians(device)
    for name in names:
        if time.monotonic() >= machine.deadline:
            return
        report(running.run_rate(machine, name, medians.get(name.removeprefix("rate/"))))


def _read_outcomes(results: Path, mark: list[str | None]) -> dict[str, CheckOutcome]:
    """Return the last outcome of each check of this commit and device."""
    outcomes = {}
    lines = results.read_text().splitlines() if results.is_file() else []
    for line in lines:
        row = json.loads(line)
        if row.pop("mark") == mark:
            row.pop("at_utc")
            outcomes[row["name"]] = CheckOutcome(**row)
    return outcomes


def _store_medians(outcomes: dict[str, CheckOutcome], about: dict[str, Any]) -> None:
    provenance = {
        "commit": about["commit"],
        "date": datetime.now(UTC).date().isoformat(),
        "driver": about["driver"],
        "jax": about["versions"]["jax"],
    }
    rows = {
        name.removeprefix("rate/"): {key: outcome.row[key] for key in ROW_FIELDS} | provenance
        for name, outcome in outcomes.items()
        if outcome.row
    }
    workloads.write_medians(about["device"], rows)
    print(f"{workloads.STORED}: {len(rows)} medians of {about['device']}")


def _print_summary(
    chosen: list[str], outcomes: dict[str, CheckOutcome], about: dict[str, Any]
) -> int:
    """Print the outcome of each check and of all; return the exit status."""
    statuses = {
        name: outcomes[name].status if name in outcomes else "unfinished" for name in chosen
    }
    print()
    for status in ("skipped", "unfinished", "slower", "failed"):
        for name in (name for name in chosen if statuses[name] == status):
            reason = outcomes[name].reason if name in outcomes else "not begun"
            print(f"{status:10} {name}: {(reason.splitlines() or [''])[-1]}")
    counts = {
        status: sum(other_status == status for other_status in statuses.values())
        for status in ("passed", "failed", "slower", "skipped", "unfinished")
    }
    print(
        f"\ncard {about['device']}, driver {about['driver']}, jax {about['versions']['jax']}, "
        f"commit {about['commit']}, {about['cpu_count']} processors"
    )
    print(f"gpu-check: {', '.join(f'{count} {status}' for status, count in counts.items())}")
    if counts["failed"] or counts["slower"]:
        return 1
    return 3 if counts["unfinished"] else 0


if __name__ == "__main__":
    raise SystemExit(main(tyro.cli(GpuCheckOptions)))
