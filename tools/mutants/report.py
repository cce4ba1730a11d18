"""Report of a sample: the fraction of caught faults, and every fault that survived."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from tools.mutants.trials import TrialRow

_TWO_SIDED_95 = 1.96


def caught_fraction(caught: int, total: int) -> tuple[float, float, float]:
    """Return the caught fraction and its 95 % interval after Wilson."""
    if total == 0:
        return math.nan, 0.0, 1.0
    p, z2 = caught / total, _TWO_SIDED_95**2
    centre = (p + z2 / (2 * total)) / (1 + z2 / total)
    half_width = (
        _TWO_SIDED_95 / (1 + z2 / total) * math.sqrt(p * (1 - p) / total + z2 / (4 * total * total))
    )
    return p, centre - half_width, centre + half_width


def read_equivalents(file: Path) -> dict[tuple[str, str], str]:
    """Read the reviewed faults that change nothing relevant: file and changed lines -> reason."""
    rows = tomllib.loads(file.read_text()).get("equivalent", [])
    return {(row["file"], _changed_lines(row["diff"])): row["why"] for row in rows}


def _changed_lines(diff: str) -> str:
    """Return the changed lines of a diff without their indentation."""
    return "\n".join(
        f"{line[0]} {line[1:].strip()}"
        for line in diff.strip().splitlines()
        if line[:1] in "+-" and not line.startswith(("+++", "---"))
    )


class JudgedRow(TrialRow):
    """Row of a tried mutant, with the reason why it is equivalent, if it is."""

    why: str | None


def format_report(
    folders: Sequence[str],
    rows: Sequence[TrialRow],
    missing: int,
    reasons: Mapping[tuple[str, str], str],
    gone: Sequence[str] = (),
) -> str:
    """Return Markdown: a table by folder, then the survivors with their diffs.

    Args:
        folders: mutated folders.
        rows: results.
        missing: mutants of the sample without a result.
        reasons: see `read_equivalents`.
        gone: ``file:line`` of rows of a stored list whose lines no longer stand in their file;
            they are in no count.
    """
    kinds = ("caught", "stuck", "equivalent", "survived")
    lines = [f"| folder | mutants | {' | '.join(kinds)} | share (95 %) |", "|---|" + "---|" * 6]
    judged_rows = [
        JudgedRow(**row, why=reasons.get((row["file"], _changed_lines(row["diff"]))))
        for row in rows
    ]
    for folder in [*folders, "all"]:
        folder_rows = [
            row for row in judged_rows if folder == "all" or row["file"].startswith(folder + "/")
        ]
        count = dict.fromkeys(kinds, 0)
        for row in folder_rows:
            count["equivalent" if _is_equivalent(row) else row["outcome"]] += 1
        judged = len(folder_rows) - count["equivalent"]
        p, low, high = caught_fraction(count["caught"] + count["stuck"], judged)
        rate = f"{p:.1%} ({low:.1%} to {high:.1%})" if judged else ""
        lines.append(
            f"| {folder} | {' | '.join(map(str, [len(folder_rows), *count.values()]))} | {rate} |"
        )
    if missing:
        lines += ["", f"{missing} of the sample not tried yet."]
    if gone:
        lines += ["", f"{len(gone)} of the list gone, in no count: {', '.join(gone)}."]
    for row in judged_rows:
        if row["outcome"] == "survived" and not _is_equivalent(row):
            lines += _format_survivor(row)
    return "\n".join(lines)


def _is_equivalent(row: JudgedRow) -> bool:
    return row["outcome"] == "survived" and row["why"] is not None


def _format_survivor(row: TrialRow) -> list[str]:
    not_run = f"; {row['left']} more had no time" if row["left"] else ""
    return [
        *["", f"### {row['mutant']} {row['file']}:{row['line']} ({row['operator']})", ""],
        *[f"{len(row['tried'])} test files passed in {row['seconds']:.0f} s{not_run}.", ""],
        *["```diff", row["diff"], "```"],
    ]
