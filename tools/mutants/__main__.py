"""``python -m tools.mutants``: sample mutants, run the tests on them, report."""

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from tools.mutants import mutant_list, report, trials
from tools.mutants.mutant import Mutant
from tools.mutants.relevance import ImportGraph

ROOT = Path(__file__).parents[2]
FOLDERS = (
    *(
        "angler_mjx/sim",
        "angler_mjx/sim/engines",
        "angler_mjx/sim/physics",
        "angler_mjx/robot/control",
    ),
    *("angler_mjx/planning", "angler_mjx/scenario", "angler_mjx/runs/simulator", "angler_mjx/runs"),
    *("angler_mjx/runs/storage", "kernels/angler_kernels"),
)


@dataclass(frozen=True, kw_only=True)
class MutantOptions:
    """Try small faults, one at a time, on the tests that can detect them.

    Known results are not repeated: an interrupted run resumes.
    """

    sample: int = 300
    """Number of mutants."""
    seed: int = 0
    """Seed of the sample. Same tree, same folders, same seed: same mutants."""
    folders: tuple[str, ...] | None = None
    """Folders whose modules are mutated; with --stored, rooms of the list. Left out: engines,
    physics, control, planning, scenarios, runs and storage, or all rooms of the list."""
    stored: Path | None = None
    """Try the mutants of this list (JSON lines) instead of a sample; --sample and --seed do
    nothing."""
    workers: int = max(1, (os.cpu_count() or 1) // 2)
    """Copies of the tree, each with its part of the processors."""
    nearest: int | None = None
    """Maximum number of test files for a mutant, the nearest."""
    minutes: float = 15.0
    """Minutes for one mutant, after which no further test file begins, and it counts as
    survived."""
    hours: float = 8.0
    """Hours after which no further mutant begins."""
    out: Path = ROOT / ".mutants"
    """Folder for results, copies and compiled programs."""
    again: bool = False
    """Try once more the mutants that survived."""
    list: bool = False
    """Only show the sample, its diffs and the number of relevant test files."""
    report: bool = False
    """Only report the known results of the sample."""


def main(options: MutantOptions) -> int:
    """Run the options' command; return the exit status."""
    if options.workers < 1:
        return _print_error(f"--workers {options.workers}: must be at least 1")
    try:
        folders, mutants, gone = _select_mutants(options)
    except ValueError as error:
        return _print_error(str(error))
    if options.list:
        imports = ImportGraph(ROOT)
        for mutant in mutants:
            print(
                f"{mutant.name} {mutant.operator} "
                f"{len(imports.measure_distances(mutant.file))}\n{mutant.diff}\n"
            )
        return 0
    if not options.report:
        _try_mutants(options, mutants)
    results = _read_results(options)
    rows = [results[mutant.name] for mutant in mutants if mutant.name in results]
    reasons = report.read_equivalents(Path(__file__).with_name("equivalent.toml"))
    text = report.format_report(folders, rows, len(mutants) - len(rows), reasons, gone)
    print(text)
    if rows:
        (options.out / "report.md").write_text(text + "\n")
    return 0


def _select_mutants(options: MutantOptions) -> tuple[Sequence[str], list[Mutant], list[str]]:
    """Return the folders of the report, the mutants, and the rows of a list that are gone.

    Raises:
        ValueError: a folder or the extra is missing, the sample is empty, or see
            `mutant_list.load_list`.
    """
    if options.stored is not None:
        listed = mutant_list.load_list(ROOT, options.stored, options.folders)
        return listed.rooms, listed.mutants, listed.gone
    folders = FOLDERS if options.folders is None else options.folders
    if missing := [folder for folder in folders if not (ROOT / folder).is_dir()]:
        raise ValueError(f"there is no folder {', '.join(missing)} in {ROOT}")
    if options.sample < 1:
        raise ValueError(f"--sample {options.sample}: must be at least 1")
    try:
        from tools.mutants.positions import sample_mutants
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith(("cosmic_ray", "parso", "stevedore")):
            raise
        raise ValueError(f"{error.name} is missing; install the extra `mutants`") from None
    return folders, sample_mutants(ROOT, folders, options.sample, options.seed), []


def _print_error(reason: str) -> int:
    print(f"mutants: {reason}", file=sys.stderr)
    return 2


def _read_results(options: MutantOptions) -> dict[str, trials.TrialRow]:
    """Return the last result of each mutant."""
    rows = trials.read_rows(options.out / "results.jsonl")
    return {row["mutant"]: trials.TrialRow(**row) for row in rows}


def _try_mutants(options: MutantOptions, mutants: Sequence[Mutant]) -> None:
    """Try the mutants without a result, or those that survived and are to be tried again."""
    results = _read_results(options)
    todo = [
        mutant_to_try
        for mutant_to_try in mutants
        if mutant_to_try.name not in results
        or (options.again and results[mutant_to_try.name]["outcome"] == "survived")
    ]
    print(f"mutants: {len(mutants)} drawn, {len(todo)} to try", flush=True)
    if not todo:
        return
    end_s = time.monotonic() + 3600 * options.hours
    trees = trials.copy_trees(ROOT, options.out, options.workers)
    imports = ImportGraph(trees[0].root)
    changed = {mutant_to_try.file for mutant_to_try in todo}
    needed_tests = {
        test for file in changed for test in imports.rank_tests(file, nearest=options.nearest)
    }
    seconds = trials.measure_tests(trees, sorted(needed_tests), options.out)

    def ranked(mutant: Mutant) -> list[str]:
        return imports.rank_tests(mutant.file, seconds, options.nearest)

    trials.try_all(
        trees,
        todo,
        options.out,
        seconds,
        ranked=ranked,
        limit_s=60 * options.minutes,
        until=end_s,
    )


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(MutantOptions)))
    except KeyboardInterrupt:
        print("mutants: stopped; the same command goes on from here", file=sys.stderr)
        sys.exit(130)
