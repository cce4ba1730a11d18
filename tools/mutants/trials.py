"""Put every mutant of a sample to the tests, several at once, and keep what became of each."""

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
from typing import Any, Literal

from tools.mutants.mutant import Mutant
from tools.mutants.trees import WorkerTree

type Outcome = Literal["caught", "stuck", "survived"]
"""A test failed; the tests took far longer than they do; all that were run passed."""

START_S = 15.0
"""Beside the tests' own time: importing, with two processors to a worker."""
MAX_SLOWDOWN = 4.0
"""A fault makes XLA compile anew what the cache would have held: only beyond this many times what
the tests take without it they are stuck."""
CHUNK_S = 60.0
"""Test files that take less than this one after another are run by one process."""


@dataclass(frozen=True, kw_only=True)
class MutantResult:
    """What became of a mutant."""

    mutant: str
    file: str
    line: int
    operator: str
    diff: str
    outcome: Outcome
    by: str
    """The test that caught it."""
    seconds: float
    tried: tuple[str, ...]
    """Test files that were run."""
    left: int
    """Relevant test files that the time was too short for."""


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Lines of JSON; the last one may have been cut short by whatever ended the program."""
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
    """A file of JSON lines that several threads write."""

    def __init__(self, file: Path) -> None:
        """Open or begin it."""
        self._file, self._lock = file, threading.Lock()
        file.parent.mkdir(parents=True, exist_ok=True)

    def write(self, row: Mapping[str, Any]) -> None:
        """Add a line; what a crash cut short is closed first."""
        with self._lock, self._file.open("ab+") as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    file.write(b"\n")
            file.write(json.dumps(row).encode() + b"\n")


def copy_trees(root: Path, folder: Path, workers: int) -> list[WorkerTree]:
    """A copy of the tree for each worker, with its share of the processors."""
    cores = sorted(os.sched_getaffinity(0))
    core_groups = [cores[i::workers] or [cores[i % len(cores)]] for i in range(workers)]
    return [
        WorkerTree(root, folder / "trees" / str(i), folder / "xla", cores_of_tree)
        for i, cores_of_tree in enumerate(core_groups)
    ]


def run_all[T](
    trees: Sequence[WorkerTree], work: Sequence[T], action: Callable[[WorkerTree, T], None]
) -> None:
    """Do something for each piece of work, each tree one at a time; the first error ends it all."""
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
        except BaseException:  # an interrupt, too, must not wait for tests of many minutes
            pool.shutdown(wait=False, cancel_futures=True)
            for tree in trees:
                tree.stop()
            raise


def measure_tests(
    trees: Sequence[WorkerTree], files: Sequence[str], folder: Path
) -> dict[str, float]:
    """Seconds that each test file takes without a fault, most programs being compiled for it.

    What fails without a fault, or takes more than 15 minutes, tells nothing and is left out.
    Times are kept, and taken again only for files that changed or failed.
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
    """Of a file's bytes."""
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
        tree: to put it in.
        mutant: the fault.
        files: relevant test files in order.
        seconds: what each takes without a fault.
        limit_s: no further files are begun after so long.
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
    """Put mutants to the tests until all are through or the time is up.

    Args:
        trees: of the workers.
        mutants: those that nothing is known of yet.
        folder: of the results.
        seconds: what each test file takes.
        ranked: test files of a mutant, the nearest first.
        limit_s: for one mutant.
        until: `time.monotonic` after which none is begun.
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
