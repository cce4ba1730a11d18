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
from tools.mutants.trees import Tree

type Outcome = Literal["caught", "stuck", "survived"]
"""A test failed; the tests took far longer than they do; all that were run passed."""

START_S = 15.0
"""Beside the tests' own time: importing, with two processors to a worker."""
SLOWER = 4.0
"""A fault makes XLA compile anew what the cache would have held: only beyond this many times what
the tests take without it they are stuck."""
TOGETHER_S = 60.0
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


def read(file: Path) -> list[dict[str, Any]]:
    """Lines of JSON; the last one may have been cut short by whatever ended the program."""
    if not file.exists():
        return []
    found = []
    for line in file.read_text().splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


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


def plant(root: Path, folder: Path, workers: int) -> list[Tree]:
    """A copy of the tree for each worker, with its share of the processors."""
    cores = sorted(os.sched_getaffinity(0))
    shares = [cores[i::workers] or [cores[i % len(cores)]] for i in range(workers)]
    return [
        Tree(root, folder / "trees" / str(i), folder / "xla", share)
        for i, share in enumerate(shares)
    ]


def all_of[T](trees: Sequence[Tree], work: Sequence[T], do: Callable[[Tree, T], None]) -> None:
    """Do something for each piece of work, each tree one at a time; the first error ends it all."""
    free: queue.SimpleQueue[Tree] = queue.SimpleQueue()
    for tree in trees:
        free.put(tree)

    def on_a_free_one(one: T) -> None:
        tree = free.get()
        try:
            do(tree, one)
        finally:
            free.put(tree)

    with ThreadPoolExecutor(len(trees)) as pool:
        jobs = [pool.submit(on_a_free_one, one) for one in work]
        try:
            for job in as_completed(jobs):
                job.result()
        except BaseException:  # an interrupt, too, must not wait for tests of many minutes
            pool.shutdown(wait=False, cancel_futures=True)
            for tree in trees:
                tree.stop()
            raise


def measure(trees: Sequence[Tree], files: Sequence[str], folder: Path) -> dict[str, float]:
    """Seconds that each test file takes without a fault, most programs being compiled for it.

    What fails without a fault, or takes more than 15 minutes, tells nothing and is left out.
    Times are kept, and taken again only for files that changed or failed.
    """
    kept, book = folder / "tests.jsonl", MutantLog(folder / "tests.jsonl")
    root = trees[0].root
    stamp = {file: hash_of(root / file) for file in files}
    known = {row["file"]: row for row in read(kept)}
    fresh = {
        file for file, row in known.items() if row["passed"] and row["hash"] == stamp.get(file)
    }
    new = [file for file in files if file not in fresh]

    def once(tree: Tree, file: str) -> None:
        ran = tree.test([file], 900.0)
        row = {"file": file, "hash": stamp[file], "seconds": ran.seconds, "passed": ran.passed}
        book.write(row | {"said": "" if ran.passed else ran.failed})
        print(f"{'    ok' if ran.passed else 'FAILED'} {ran.seconds:7.1f} s  {file}", flush=True)

    all_of(trees, new, once)
    known = {row["file"]: row for row in read(kept)}
    lost = [file for file in files if not known[file]["passed"]]
    if lost:
        print(f"mutants: without a fault these fail, and are left out: {', '.join(lost)}")
    return {file: known[file]["seconds"] for file in files if file not in lost}


def hash_of(file: Path) -> str:
    """Of a file's bytes."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12]


def attempt(
    tree: Tree, mutant: Mutant, files: Sequence[str], seconds: Mapping[str, float], limit_s: float
) -> MutantResult:
    """Run the tests of one mutant, the nearest first.

    Args:
        tree: to put it in.
        mutant: the fault.
        files: relevant test files in order.
        seconds: what each takes without a fault.
        limit_s: no further files are begun after so long.
    """
    result = _untried(mutant, len(files))
    began = time.monotonic()
    rest = list(files)
    with tree.holding(mutant.file, mutant.code):
        while rest and result.outcome == "survived" and time.monotonic() - began < limit_s:
            chunk = [rest.pop(0)]
            while rest and sum(seconds[f] for f in [*chunk, rest[0]]) < TOGETHER_S:
                chunk.append(rest.pop(0))
            most = START_S + SLOWER * (START_S + sum(seconds[f] for f in chunk))
            ran = tree.test(chunk, most)
            outcome: Outcome = "survived"
            if not ran.passed:
                outcome = "stuck" if ran.code is None else "caught"
            result = replace(
                result,
                outcome=outcome,
                by=ran.failed if outcome == "caught" else "",
                tried=(*result.tried, *chunk),
                left=len(rest),
            )
    return replace(result, seconds=round(time.monotonic() - began, 1))


def _untried(mutant: Mutant, files: int) -> MutantResult:
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
    trees: Sequence[Tree],
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
    book = MutantLog(folder / "results.jsonl")

    def one(tree: Tree, mutant: Mutant) -> None:
        if time.monotonic() > until:
            return
        result = attempt(tree, mutant, ranked(mutant), seconds, limit_s)
        book.write(asdict(result))
        where = f"{result.file}:{result.line}"
        print(f"{result.outcome:8} {result.seconds:6.0f} s  {where}  {result.by}", flush=True)

    all_of(trees, mutants, one)
