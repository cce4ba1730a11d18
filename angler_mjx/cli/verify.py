"""`angler verify`: a run evaluated again from its trajectories, and compared with its results."""

import json as text
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from angler_mjx.cli.export import parse_indices

if TYPE_CHECKING:
    from angler_mjx.testing.referee import RefereeVerdict

EXIT_DISAGREES = 1
EXIT_INCONCLUSIVE = 3

MAX_DIFFERENCES = 100
"""Max number of differences printed; the JSON object holds all."""


def verify(
    run: Annotated[Path, tyro.conf.Positional],
    worlds: str | None = None,
    json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Evaluate a run again from its trajectories, and print the differences to its results.

    An independent evaluation, which shares no code with the simulator, computes every robot's
    outcome, times, path, energy, clearance and touch. Record at the control rate (--record-hz 20
    where control_dt_s is 0.05) to compute all of them; other runs are bounded only where exact
    values cannot be computed. Exits with 0 when all values agree and outcomes were computed, with 1
    when values disagree, with 2 when the run cannot be evaluated, with 3 when all values agree but
    no outcome could be computed.

    Args:
        run: Run folder.
        worlds: Indices of the worlds, as in 0,3; all finished worlds if left out.
        json: Print one JSON object instead of the table.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.cli.shared.consoles import make_progress_console
    from angler_mjx.testing import referee

    world_indices = None if worlds is None else parse_indices(worlds)
    columns = ("worlds", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=make_progress_console(quiet=json)) as bar:
        task = bar.add_task("worlds", total=None)
        verdict = referee.judge(
            run, world_indices, lambda done, total: bar.update(task, completed=done, total=total)
        )
    if json:
        print(text.dumps(verdict.table()))
    else:
        _print_verdict(verdict)
    if verdict.conclusion == "disagrees":
        sys.exit(EXIT_DISAGREES)
    if verdict.conclusion == "inconclusive":
        sys.exit(EXIT_INCONCLUSIVE)


def _print_verdict(verdict: "RefereeVerdict") -> None:
    from rich.console import Console

    from angler_mjx.cli.shared.text_table import build_text_table as text_table
    from angler_mjx.runs.storage import planning_summary
    from angler_mjx.testing.referee import (
        CARRY_QUANTITIES,
        CONTACT_QUANTITIES,
        QUANTITIES,
        TASK_QUANTITIES,
    )

    for finding in verdict.differences[:MAX_DIFFERENCES]:
        print(finding.line())
    if (n_hidden := len(verdict.differences) - MAX_DIFFERENCES) > 0:
        print(f"... and {n_hidden} more; --json holds all of them")
    if verdict.finished_worlds < verdict.planned_worlds:
        print(f"{verdict.finished_worlds} of {verdict.planned_worlds} worlds have results")
    table = text_table(
        "quantity",
        "exact",
        "bounded",
        "not checked",
        "undecided",
        "disagree",
        "largest deviation that agrees",
        title=f"{verdict.run}: {verdict.worlds} worlds, {verdict.robots} robots, "
        f"sampled {verdict.sampled}",
    )
    units = {**QUANTITIES, **TASK_QUANTITIES, **CONTACT_QUANTITIES, **CARRY_QUANTITIES}
    for name, count in verdict.counts.items():
        unit = units[name]
        numbers = (count.exact, count.bounded, count.unchecked, count.undecided, count.disagrees)
        unit = "of it" if name == "energy_j" else unit
        largest = f"{count.largest:.2g} {unit}" if unit and count.exact else ""
        table.add_row(name, *map(str, numbers), largest)
    Console().print(table)
    print(f"outcomes: {verdict.counts['outcome'].text()}")
    for line in planning_summary.early_lines(verdict.passed_goal_early):
        print(line)
    print(_format_conclusion(verdict))


def _format_conclusion(verdict: "RefereeVerdict") -> str:
    """Return the last line: the conclusion of the findings."""
    if verdict.conclusion == "disagrees":
        wrong = sum(count.disagrees for count in verdict.counts.values())
        return f"does not agree: {wrong} findings"
    if verdict.conclusion == "inconclusive":
        return "inconclusive: nothing disagrees, but no outcome could be worked out anew"
    return verdict.conclusion
