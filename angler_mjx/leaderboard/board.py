"""Board of the benchmark: one static page with the scores of all submissions.

It is made of ``result.json`` files alone, so that anybody can rebuild it. Submissions are ordered
by the fraction of entered problems that they solve; those that enter fewer sets stand in a table of
their own for these sets, because easy sets would raise their fraction.
"""

import shutil
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import checking, problem_sets
from angler_mjx.leaderboard.scores import MEDIANS, Interval, TierScore, count_reasons, score_tiers
from angler_mjx.runs.storage.atomic_files import write_text

PAGE, RESULTS = "index.html", "results"
BASELINES = "baselines"
"""Folder of results of the package's planners, among the benchmark's files."""
_LABELS = {
    "makespan_ratio": "time / straight line",
    "energy_j_per_robot": "energy of a robot, J",
    "clearance_m": "least gap, m",
    "planning_s": "planning, s",
}
_STYLE = """
:root { color-scheme: light dark; --ink: #12303c; --paper: #ffffff; --line: #c9d6db;
  --soft: #eef3f5; --hue: 190; }
@media (prefers-color-scheme: dark) { :root { --ink: #e2edf1; --paper: #0d1b22; --line: #2c4450;
  --soft: #15272f; } }
body { max-width: 76rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5;
  font-family: system-ui, sans-serif; color: var(--ink); background: var(--paper); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.9rem; }
th, td { padding: 0.25rem 0.6rem; text-align: right; border-bottom: 1px solid var(--line);
  white-space: nowrap; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0;
  background: var(--paper); }
td.rate { background: color-mix(in srgb, hsl(var(--hue) 60% 45%) var(--part), transparent); }
small { opacity: 0.75; }
code { background: var(--soft); padding: 0 0.2rem; }
"""


def build_board(results: Sequence[Path], out: Path, *, baselines: bool) -> Path:
    """Write the board into a folder, with copies of all results.

    Args:
        results: results folders of checks, or their ``result.json``.
        out: folder of the page; replaced if it is a board.
        baselines: show the package's own planners too.

    Returns:
        The page.

    Raises:
        ConfigError: a result cannot be read, two have one name, or the folder is something else.
    """
    paths = list(results)
    if baselines:
        paths += sorted((problem_sets.data_folder() / BASELINES).glob("*.json"))
    if not paths:
        raise ConfigError(
            "angler leaderboard build: no results; name folders of angler leaderboard check"
        )
    tables = [checking.read_result(path) for path in paths]
    names: dict[str, Path] = {}
    for table, path in zip(tables, paths, strict=True):
        name = f"{table['card']['name']} ({'hidden' if table['hidden'] else 'public'})"
        if name in names:
            raise ConfigError(f"{path}: is called {name!r}, as {names[name]} is")
        names[name] = path
    if out.exists() and not (out / PAGE).is_file():
        raise ConfigError(f"{out}: is no board; choose another folder")
    shutil.rmtree(out / RESULTS, ignore_errors=True)
    (out / RESULTS).mkdir(parents=True)
    for number, path in enumerate(paths):
        source = path / checking.RESULT if path.is_dir() else path
        shutil.copyfile(source, out / RESULTS / f"{number:03d}.json")
    write_text(out / PAGE, format_board(tables))
    return out / PAGE


def format_board(tables: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of some results."""
    groups: dict[tuple[bool, tuple[str, ...]], list[Mapping[str, Any]]] = {}
    for table in tables:
        groups.setdefault((table["hidden"], tuple(table["entered"])), []).append(table)
    everything = len(problem_sets.list_problem_sets(problem_sets.load_benchmark()))
    ordered = sorted(groups.items(), key=lambda item: (item[0][0], -len(item[0][1])))
    title = problem_sets.load_benchmark().title
    sections = [
        _format_group(entered, group, hidden=hidden, everything=everything)
        for (hidden, entered), group in ordered
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}: board</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{escape(title)}</h1>\n"
        "<p>Planning for underwater fleets: 300 problems for teams of 1 to 64 robots, in open "
        "water, reefs, dense rock and a corridor; still, with moving obstacles, and in the current "
        "of an ocean model; with the true future known, or the present observed. Plans are flown "
        "in simulated truth by a fleet whose parameters the planner does not know, and a referee "
        "that shares no code with the simulator computes every score again. A problem is solved "
        "if every robot arrives and planning kept its time limit. Intervals are of 95 %.</p>\n"
        + "\n".join(sections)
        + "\n</body>\n</html>\n"
    )


def _format_group(
    entered: Sequence[str], group: Sequence[Mapping[str, Any]], *, hidden: bool, everything: int
) -> str:
    scored = [(table, score_tiers(table["scores"])) for table in group]
    scored.sort(key=lambda item: -item[1][0].solved.value)
    kind = "Hidden problems" if hidden else "Public problems"
    extent = "all sets" if len(entered) == everything else f"{len(entered)} of {everything} sets"
    tiers = [tier.name for tier in scored[0][1]]
    head = "".join(
        f"<th>{escape(name)}<br><small>{tier.problems}</small></th>"
        for name, tier in zip(tiers, scored[0][1], strict=True)
    )
    rows = "\n".join(
        f"<tr><td>{escape(table['card']['name'])}</td>"
        + "".join(_format_rate(tier.solved) for tier in scores)
        + "</tr>"
        for table, scores in scored
    )
    details = "\n".join(_format_details(table, scores[0]) for table, scores in scored)
    names = "" if len(entered) == everything else f"<p>{escape(', '.join(entered))}</p>\n"
    return (
        f"<h2>{kind}, {extent}</h2>\n{names}"
        "<p>Fraction of problems that are solved, in percent, with its interval; below each tier "
        "its number of problems.</p>\n"
        f'<div class="wide"><table><tr><th>planner</th>{head}</tr>\n{rows}\n</table></div>\n'
        "<h3>Solved problems</h3>\n<p>Medians over the problems that each planner solved: they "
        "are of different problems.</p>\n"
        '<div class="wide"><table><tr><th>planner</th><th>robots that arrived, %</th>'
        + "".join(f"<th>{escape(_LABELS[name])}</th>" for name in MEDIANS)
        + "<th>machine of planning</th><th>flown by</th><th>commonest failures</th></tr>\n"
        f"{details}\n</table></div>"
    )


def _format_rate(rate: Interval) -> str:
    return (
        f'<td class="rate" style="--part: {80 * rate.value:.0f}%">{100 * rate.value:.0f} '
        f"<small>{100 * rate.low:.0f}&ndash;{100 * rate.high:.0f}</small></td>"
    )


def _format_details(table: Mapping[str, Any], tier: TierScore) -> str:
    card = table["card"]
    cells = [
        "&ndash;"
        if (median := tier.medians[name]) is None
        else f"{median.value:.3g} <small>{median.low:.3g}&ndash;{median.high:.3g}</small>"
        for name in MEDIANS
    ]
    reasons = "; ".join(
        f"{count} {text[:60]}" for text, count in count_reasons(table["scores"])[:3]
    )
    texts = [
        escape(card.get("machine") or "not stated"),
        escape(f"angler-mjx {table['physics']['angler-mjx']}"),
        escape(reasons or "none"),
    ]
    return (
        f"<tr><td>{escape(card['name'])}<br><small>{escape(', '.join(card.get('authors', [])))}"
        f"</small></td><td>{100 * tier.arrived:.0f}</td>"
        + "".join(f"<td>{cell}</td>" for cell in [*cells, *texts])
        + "</tr>"
    )
