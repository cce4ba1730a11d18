"""Board of the benchmark: one static page with the scores of all submissions.

It is made of ``result.json`` files alone, so that anybody can rebuild it. Submissions to all sets
are ordered by the fraction of problems that they solve. Those to part of the sets stand in a table
of their own, ordered by the number of solved problems, because easy sets would raise a fraction; a
tier that they did not enter is empty. What flies without plans observes all the time and has no
time limit: it stands in tables of its own, as do hidden problems of each secret.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import check_results, problem_sets, submission
from angler_mjx.leaderboard.scores import (
    MEDIANS,
    Interval,
    TierScore,
    count_reasons,
    list_tier_groups,
    score_tiers,
)
from angler_mjx.runs.storage.atomic_files import write_text
from angler_mjx.studies.speed.measured.graph_search import REFERENCE_SEARCHES_PER_S

PAGE, RESULTS = "index.html", "results"
BASELINES = "baselines"
"""Folder of results of the package's planners, among the benchmark's files."""
_LABELS = {
    "makespan_ratio": "time / straight line",
    "energy_j_per_robot": "energy of a robot, kJ",
    "clearance_m": "least gap, m",
    "planning_s": "planning, s",
}
_SCALES = {"energy_j_per_robot": 1e-3}
"""Of the quantities in their labels' units; 1 of all others."""
_KINDS = {"plans": "plans", "program": "program, run by the judge", "in_flight": "in flight"}
_STYLE = """
:root { color-scheme: light dark; --ink: #12303c; --paper: #ffffff; --line: #c9d6db;
  --soft: #eef3f5; --link: #0b5c8a; --hue: 190; }
@media (prefers-color-scheme: dark) { :root { --ink: #e2edf1; --paper: #0d1b22; --line: #2c4450;
  --soft: #15272f; --link: #7cc7ee; } }
body { max-width: 84rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5;
  font-family: system-ui, sans-serif; color: var(--ink); background: var(--paper); }
p, ul { max-width: 48rem; }
a { color: var(--link); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.9rem; }
th, td { padding: 0.3rem 0.6rem; text-align: right; border-bottom: 1px solid var(--line);
  white-space: nowrap; vertical-align: top; }
th { vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0;
  background: var(--paper); white-space: normal; min-width: 8rem; max-width: 16rem;
  overflow-wrap: anywhere; }
th.part { border-left: 1px solid var(--line); text-align: left; color: var(--ink);
  font-weight: normal; font-size: 0.8rem; }
td.first, th.first { border-left: 1px solid var(--line); }
td.rate { background: color-mix(in srgb, hsl(var(--hue) 60% 45%) var(--part), transparent); }
td.none { color: color-mix(in srgb, var(--ink) 55%, var(--paper)); }
.details th { white-space: normal; min-width: 4.5rem; }
.details th.part { min-width: 9rem; }
td.text { text-align: left; white-space: normal; min-width: 9rem; max-width: 24rem;
  overflow-wrap: anywhere; }
small { opacity: 0.8; }
code { background: var(--soft); padding: 0 0.2rem; overflow-wrap: anywhere; }
@media (max-width: 40rem) { body { margin: 1rem auto; } th:first-child, td:first-child {
  min-width: 6.5rem; max-width: 8rem; } th, td { padding: 0.25rem 0.4rem; } }
"""


def build_board(results: Sequence[Path], out: Path, *, baselines: bool) -> Path:
    """Write the board into a folder, with copies of all results.

    Args:
        results: results folders of checks, or their ``result.json``.
        out: folder of the page; replaced if it is a board.
        baselines: show the package's own planners too, marked as baselines. A result of the same
            name stands beside them.

    Returns:
        The page.

    Raises:
        ConfigError: a result cannot be read, two have one name, or the folder is something else.
    """
    stored = sorted(baselines_folder().glob("*.json")) if baselines else []
    paths = [*results, *stored]
    if not paths:
        raise ConfigError(
            "angler leaderboard build: no results; name folders of angler leaderboard check"
        )
    tables = [check_results.read_result(path) for path in results]
    stored_tables = [check_results.read_result(path) for path in stored]
    names: dict[tuple[str, str], Path] = {}
    for table, path in zip(tables, results, strict=True):
        name = table["card"]["name"]
        if other := names.get((name, table["problems_sha256"])):
            raise ConfigError(
                f"{path}: is called {name!r}, as {other} is, of the same problems; leave one out, "
                f"or give it another name in its {submission.CARD} and check it again"
            )
        names[name, table["problems_sha256"]] = path
    if out.exists() and not (out / PAGE).is_file():
        raise ConfigError(f"{out}: is no board; choose another folder")
    shutil.rmtree(out / RESULTS, ignore_errors=True)
    (out / RESULTS).mkdir(parents=True)
    for number, path in enumerate(paths):
        source = path / check_results.RESULT if path.is_dir() else path
        shutil.copyfile(source, out / RESULTS / f"{number:03d}.json")
    write_text(out / PAGE, format_board(tables, stored_tables))
    return out / PAGE


def baselines_folder() -> Path:
    """Return the folder of stored results of the package's planners."""
    return problem_sets.data_folder() / BASELINES


def format_board(
    results: Sequence[Mapping[str, Any]], baselines: Sequence[Mapping[str, Any]]
) -> str:
    """Return the page of results and baselines, whose copies stand in this order in `RESULTS`."""
    benchmark = problem_sets.load_benchmark()
    every = problem_sets.list_problem_sets(benchmark)
    problems = sum(entry.problems for entry in every)
    entries = [
        BoardEntry(
            table=table,
            source=f"{RESULTS}/{number:03d}.json",
            tiers={tier.name: tier for tier in score_tiers(table["scores"])},
            is_whole=len(table["scores"]) == problems,
            is_baseline=number >= len(results),
        )
        for number, table in enumerate([*results, *baselines])
    ]
    groups: dict[BoardTable, list[BoardEntry]] = {}
    for entry in sorted(entries, key=lambda entry: entry.board_table):
        groups.setdefault(entry.board_table, []).append(entry)
    sections = [_format_group(group, board_table) for board_table, group in groups.items()]
    versions = sorted({f"angler-mjx {e.table['physics']['angler-mjx']}" for e in entries})
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(benchmark.title)}: board</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<h1>{escape(benchmark.title)}</h1>\n"
        f"<p>Planning for underwater fleets: {problems} problems for teams of 1 to 64 robots, in "
        "open water, reefs, dense rock and a corridor; still, with moving obstacles, and in the "
        "current of an ocean model; with the true future known, or the present observed. Plans are "
        "flown in simulated truth by a fleet whose parameters the planner does not know, and a "
        "referee that shares no code with the simulator computes every score again. A problem is "
        "solved if every robot arrives and planning kept its time limit. Planning times and "
        "machines of plans are stated by their authors; those of programs are measured by the "
        "judge.</p>\n"
        f"<p>Physics: {escape(', '.join(versions))}. Intervals are of 95 %. A dash is a tier that "
        "was not entered, which is not failed.</p>\n"
        + "\n".join(sections)
        + _format_limits(benchmark)
        + "\n</body>\n</html>\n"
    )


class BoardTable(NamedTuple):
    """What submissions of one table share; tables stand in the order of these values."""

    is_hidden: bool
    problems_sha256: str
    """Of all problems."""
    is_in_flight: bool
    is_partial: bool

    @property
    def title(self) -> str:
        """Heading of the table."""
        problems = (
            f"Hidden problems {self.problems_sha256[:8]}" if self.is_hidden else "Public problems"
        )
        kind = ", in flight" if self.is_in_flight else ""
        return f"{problems}{kind}, {'part of the sets' if self.is_partial else 'all sets'}"


@dataclass(frozen=True, kw_only=True)
class BoardEntry:
    """A submission on the board."""

    table: Mapping[str, Any]
    """Its result."""
    source: str
    """Copy of the result, relative to the page."""
    tiers: Mapping[str, TierScore]
    """Scores by names of tiers; without those that it did not enter."""
    is_whole: bool
    """Whether all problems were judged."""
    is_baseline: bool
    """Whether it is a stored result of the package's planners."""

    @property
    def solved(self) -> int:
        """Number of solved problems."""
        return sum(bool(row["solved"]) for row in self.table["scores"])

    @property
    def board_table(self) -> BoardTable:
        """Table that it stands in."""
        return BoardTable(
            is_hidden=bool(self.table["hidden"]),
            problems_sha256=str(self.table["problems_sha256"]),
            is_in_flight=self.table["card"]["kind"] == "in_flight",
            is_partial=not self.is_whole,
        )


def _format_limits(benchmark: problem_sets.FrozenBenchmark) -> str:
    cells = [
        (f"{tier.robots}", f"{tier.limit_s:g}") for tier in sorted(benchmark.team, key=_robots_of)
    ]
    return (
        "\n<h2>Time limits</h2>\n<p>Planning time for a problem on the reference core, which makes "
        f"{REFERENCE_SEARCHES_PER_S:,.0f} searches/s in <code>angler bench --workload search</code>"
        ". Times of other machines are divided by their factor, the time that a core of theirs "
        "needs over that of the reference.</p>\n"
        '<div class="wide"><table><tr><th>robots</th>'
        + "".join(f"<td>{robots}</td>" for robots, _ in cells)
        + "</tr>\n<tr><th>time limit, s</th>"
        + "".join(f"<td>{limit}</td>" for _, limit in cells)
        + "</tr></table></div>"
    )


def _robots_of(tier: problem_sets.TeamTier) -> int:
    return tier.robots


def _list_columns() -> list[tuple[str, list[tuple[str, int]]]]:
    """Return the tiers of the whole benchmark by what they are a part of, with their problems."""
    every = problem_sets.list_problem_sets(problem_sets.load_benchmark())
    rows = [
        {"robots": entry.robots, "set": entry.name}
        for entry in every
        for _ in entry.problem_names()
    ]
    parts: dict[str, list[tuple[str, int]]] = {}
    heads = ("", "robots", "environment", "condition", "information")
    for head, tiers in zip(heads, list_tier_groups(rows), strict=True):
        parts[head] = [(name, len(part)) for name, part in tiers]
    return list(parts.items())


def _format_group(group: Sequence[BoardEntry], board_table: BoardTable) -> str:
    ordered = sorted(
        group, key=lambda entry: (-entry.solved, entry.table["card"]["name"], entry.is_baseline)
    )
    columns = _list_columns()
    head = "".join(
        f'<th class="part" colspan="{len(tiers)}">{part}</th>' for part, tiers in columns
    )
    names = "".join(
        f"<th{_first(at)}>{escape(name.split(' ')[0])}<br><small>{count}</small></th>"
        for _, tiers in columns
        for at, (name, count) in enumerate(tiers)
    )
    rows = "\n".join(
        f"<tr><td>{escape(entry.table['card']['name'])}"
        + ("<br><small>baseline</small>" if entry.is_baseline else "")
        + "</td>"
        + "".join(
            _format_rate(entry.tiers.get(name), count, at)
            for _, tiers in columns
            for at, (name, count) in enumerate(tiers)
        )
        + "</tr>"
        for entry in ordered
    )
    notes = ""
    if board_table.is_in_flight:
        notes += (
            " They observe obstacles and current all the time, where a planner observes the start, "
            "and their time has no limit."
        )
    if board_table.is_partial:
        notes += (
            " Of a tier that was entered in part, the third line is solved of entered problems."
        )
    details = "\n".join(_format_details(entry) for entry in ordered)
    return (
        f"<h2>{escape(board_table.title)}</h2>\n"
        "<p>Solved problems in percent of those that were entered, and the interval; below each "
        f"tier its number of problems.{notes}</p>\n"
        f'<div class="wide"><table><tr><th></th>{head}</tr>\n<tr><th>planner</th>{names}</tr>\n'
        f"{rows}\n</table></div>\n"
        "<h3>Solved problems</h3>\n<p>Medians over the problems that each planner solved, with "
        "intervals: they are of different problems.</p>\n"
        '<div class="wide"><table class="details"><tr><th>planner</th>'
        "<th>robots that arrived, %</th>"
        + "".join(f"<th>{escape(_LABELS[name])}</th>" for name in MEDIANS)
        + '<th class="part">kind; machine of planning</th>'
        '<th class="part">flown by</th><th class="part">commonest failures</th></tr>\n'
        f"{details}\n</table></div>"
    )


def _first(at: int) -> str:
    return ' class="first"' if at == 0 else ""


def _format_rate(tier: TierScore | None, problems: int, at: int) -> str:
    first = " first" if at == 0 else ""
    if tier is None:
        return f'<td class="none{first}" title="not entered">&ndash;</td>'
    rate = tier.solved
    part = (
        f"<br><small>{round(rate.value * rate.count)} of {rate.count}</small>"
        if rate.count < problems
        else ""
    )
    return (
        f'<td class="rate{first}" style="--part: {80 * rate.value:.0f}%">{100 * rate.value:.0f}'
        f"<br><small>{100 * rate.low:.0f}&ndash;{100 * rate.high:.0f}</small>{part}</td>"
    )


def _shorten(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def _format_median(median: Interval, scale: float) -> str:
    value, low, high = (scale * x for x in (median.value, median.low, median.high))
    return f"{value:.3g}<br><small>{low:.3g}&ndash;{high:.3g}</small>"


def _format_physics(table: Mapping[str, Any]) -> str:
    physics = table["physics"]
    commit = str(physics.get("commit") or "")
    mark = "+" if not commit.isalnum() and commit else ""
    return f"angler-mjx {physics['angler-mjx']}" + (f" ({commit[:8]}{mark})" if commit else "")


def _format_details(entry: BoardEntry) -> str:
    table, tier = entry.table, entry.tiers["all"]
    card = table["card"]
    cells = [
        "&ndash;"
        if (median := tier.medians[name]) is None
        else _format_median(median, _SCALES.get(name, 1.0))
        for name in MEDIANS
    ]
    reasons = "; ".join(
        f"{count} x {_shorten(text)}" for text, count in count_reasons(table["scores"])[:3]
    )
    planned = table.get("planned_on", {})
    machine = planned.get("machine") or card.get("machine") or "machine not stated"
    texts = [
        escape(f"{_KINDS[card['kind']]}; {machine}, {_format_factor(table['scores'])}"),
        escape(f"{_format_physics(table)} on {table['judged_on']}"),
        escape(reasons or "none"),
    ]
    authors = "baseline" if entry.is_baseline else escape(", ".join(card.get("authors", [])))
    return (
        f'<tr><td><a href="{entry.source}" title="{escape(card.get("description", ""))}">'
        f"{escape(card['name'])}</a><br><small>{authors}{_format_url(card)}</small></td>"
        f"<td>{100 * tier.arrived:.0f}</td>"
        + "".join(f"<td>{cell}</td>" for cell in cells)
        + "".join(f'<td class="text">{text}</td>' for text in texts)
        + "</tr>"
    )


def _format_factor(rows: Sequence[Mapping[str, Any]]) -> str:
    factors = [float(row["time_factor"]) for row in rows]
    low, high = min(factors), max(factors)
    return f"factor {low:.2f}" if high - low < 0.005 else f"factors {low:.2f} to {high:.2f}"


def _format_url(card: Mapping[str, Any]) -> str:
    """Return a link to the page that a card names; empty where it names none on the web."""
    url = str(card.get("url", ""))
    is_of_web = url.startswith(("https://", "http://"))
    return f' <a href="{escape(url)}">page</a>' if is_of_web else ""
