"""Trials of all mutants of a sample, several at once, with a log of results."""

import hashlib
import json
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypedDict

from tools.mutants.mutant import Mutant
from tools.mutants.trees import WorkerTree

type Outcome = Literal["caught", "stuck", "survived"]
"""Result: a test failed; the tests took far longer than usual; all tests that ran passed."""

START_S = 15.0
"""Seconds beside the tests' own time: importing, with two processors per worker."""
MAX_SLOWDOWN = 4.0
"""Factor on the usual time beyond which tests count as stuck. A fault makes XLA compile anew
programs that the cache would have held."""
CHUNK_S = 60.0
"""Seconds of test files that one process runs in sequence."""


@dataclass(frozen=True, kw_only=True)
class MutantResult:
    """Result of a mutant."""

    mutant: str
    file: str
    line: int
    operator: str
    diff: str
    outcome: Outcome
    by: str
    """Test that caught the mutant."""
    seconds: float
    tried: tuple[str, ...]
    """Number of test files that were run."""
    left: int
    """Number of relevant test files that did not fit into the time."""


class TrialRow(TypedDict):
    """Result of a mutant."""

    mutant: str
    file: str
    line: int
    operator: str
    diff: str
    outcome: str
    tried: list[str]
    """Test files that were run."""
    left: int
    """Number of test files without time."""
    seconds: float


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Read lines of JSON; a truncated last line is skipped."""
    if not file.exists():
        return []
    rows = []
    for line in file.read_text().splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


class MutantLog:
    """File of JSON lines that several threads write."""

    def __init__(self, file: Path) -> None:
        """Open or create the file."""
        self._file, self._lock = file, threading.Lock()
        file.parent.mkdir(parents=True, exist_ok=True)

    def write(self, row: Mapping[str, object]) -> None:
        """Write a line; a line truncated by a crash is ended first."""
        with self._lock, self._file.open("ab+") as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    file.write(b"\n")
            file.write(json.dumps(row).encode() + b"\n")


def copy_trees(root: Path, folder: Path, workers: int) -> list[WorkerTree]:
    """Copy the tree for each worker, with its part of the processors."""
    cores = sorted(os.sched_getaffinity(0))
    core_groups = [cores[i::workers] or [cores[i % len(cores)]] for i in range(workers)]
    return [
        WorkerTree(root, folder / "trees" / str(i), folder / "xla", cores_of_tree)
        for i, cores_of_tree in enumerate(core_groups)
    ]


def run_all[T](
    trees: Sequence[WorkerTree], work: Sequence[T], action: Callable[[WorkerTree, T], None]
) -> None:
    """Run an action for each item, each tree one at a time; the first error ends all."""
    free: queue.SimpleQueue[WorkerTree] = queue.SimpleQueue()
    for tree in trees:
        free.put(tree)

    def run_on_free_tree(item: T) -> None:
        tree = free.get()
        try:
            action(tree, item)
        finally:
            free.put(tree)

    with ThreadPoolExecutor(len(trees)) as pool:
        jobs = [pool.submit(run_on_free_tree, item) for item in work]
        try:
            for job in as_completed(jobs):
                job.result()
        except BaseException:  # an interrupt must not wait for tests of many minutes either
            pool.shutdown(wait=False, cancel_futures=True)
            for tree in trees:
                tree.stop()
            raise


def measure_tests(
    trees: Sequence[WorkerTree], files: Sequence[str], folder: Path
) -> dict[str, float]:
    """Measure the seconds of each test file without a fault, compiling most programs for it.

    A test file that fails without a fault, or takes more than 15 minutes, is left out. Times are
    kept, and taken again only for files that changed or failed.
    """
    results_file, log = folder / "tests.jsonl", MutantLog(folder / "tests.jsonl")
    root = trees[0].root
    stamp = {file: hash_file(root / file) for file in files}
    results = {row["file"]: row for row in read_rows(results_file)}
    fresh = {
        file for file, row in results.items() if row["passed"] and row["hash"] == stamp.get(file)
    }
    new = [file for file in files if file not in fresh]

    def time_file(tree: WorkerTree, file: str) -> None:
        run = tree.run_tests([file], 900.0)
        row = {"file": file, "hash": stamp[file], "seconds": run.seconds, "passed": run.has_passed}
        log.write(row | {"said": "" if run.has_passed else run.failed})
        print(
            f"{'    ok' if run.has_passed else 'FAILED'} {run.seconds:7.1f} s  {file}", flush=True
        )

    run_all(trees, new, time_file)
    results = {row["file"]: row for row in read_rows(results_file)}
    failing = [file for file in files if not results[file]["passed"]]
    if failing:
        print(f"mutants: without a fault these fail, and are left out: {', '.join(failing)}")
    return {file: results[file]["seconds"] for file in files if file not in failing}


def hash_file(file: Path) -> str:
    """Return the hash of a file's bytes."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12]


def try_mutant(
    tree: WorkerTree,
    mutant: Mutant,
    files: Sequence[str],
    seconds: Mapping[str, float],
    limit_s: float,
) -> MutantResult:
    """Run the tests of one mutant, the nearest first.

    Args:
        tree: tree in which the fault is put.
        mutant: mutant to try.
        files: relevant test files in order.
        seconds: duration of each file without a fault.
        limit_s: time after which no further files begin.
    """
    result = _untried_result(mutant, len(files))
    began = time.monotonic()
    remaining = list(files)
    with tree.replace_file(mutant.file, mutant.code):
        while remaining and result.outcome == "survived" and time.monotonic() - began < limit_s:
            chunk = [remaining.pop(0)]
            while remaining and sum(seconds[f] for f in [*chunk, remaining[0]]) < CHUNK_S:
                chunk.append(remaining.pop(0))
            chunk_limit_s = START_S + MAX_SLOWDOWN * (START_S + sum(seconds[f] for f in chunk))
            run = tree.run_tests(chunk, chunk_limit_s)
            outcome: Outcome = "survived"
            if not run.has_passed:
                outcome = "stuck" if run.code is None else "caught"
            result = replace(
                result,
                outcome=outcome,
                by=run.failed if outcome == "caught" else "",
                tried=(*result.tried, *chunk),
                left=len(remaining),
            )
    return replace(result, seconds=round(time.monotonic() - began, 1))


def _untried_result(mutant: Mutant, files: int) -> MutantResult:
    return MutantResult(
        mutant=mutant.name,
        file=mutant.file,
        line=mutant.line,
        operator=mutant.operator,
        diff=mutant.diff,
        outcome="survived",
        by="",
        seconds=0.0,
        tried=(),
        left=files,
    )


def try_all(
    trees: Sequence[WorkerTree],
    mutants: Sequence[Mutant],
    folder: Path,
    seconds: Mapping[str, float],
    *,
    ranked: Callable[[Mutant], list[str]],
    limit_s: float,
    until: float,
) -> None:
    """Try mutants until all have results or the time is up.

    Args:
        trees: trees of the workers.
        mutants: mutants without a result.
        folder: folder of the results.
        seconds: duration of each test file.
        ranked: test files of a mutant, the nearest first.
        limit_s: time limit of one mutant.
        until: `time.monotonic` after which no mutant begins.
    """
    log = MutantLog(folder / "results.jsonl")

    def run_mutant(tree: WorkerTree, mutant: Mutant) -> None:
        if time.monotonic() > until:
            return
        result = try_mutant(tree, mutant, ranked(mutant), seconds, limit_s)
        log.write(asdict(result))
        where = f"{result.file}:{result.line}"
        print(f"{result.outcome:8} {result.seconds:6.0f} s  {where}  {result.by}", flush=True)

    run_all(trees, mutants, run_mutant)
