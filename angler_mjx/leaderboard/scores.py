"""Scores of a checked submission: rates and medians with 95 % intervals, by tier.

No single number sums them up: arrival, time, energy and safety are different wants, and a weighting
would be ours. Boards are ordered by the fraction of entered problems that are solved.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.runs.storage.confidence_intervals import wilson_interval

type ScoreRow = Mapping[str, Any]
"""Fields of `check_results.ProblemScore`, as read from ``result.json``."""

BOOTSTRAPS, SEED = 2000, 1
MAX_FAILED_LINES = 12
"""Failed problems that are printed with their reasons."""
MEDIANS = ("makespan_ratio", "energy_j_per_robot", "clearance_m", "planning_s")
"""Quantities with medians: makespan over the straight-line bound, energy of a robot, least
clearance, planning time."""


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float
    count: int
    """Number of problems that it is of."""


@dataclass(frozen=True, kw_only=True)
class TierScore:
    """Scores of a part of the problems."""

    name: str
    problems: int
    """Entered problems."""
    solved: Interval
    """Fraction of them that are solved; Wilson's interval."""
    arrived: float
    """Fraction of their robots that arrived."""
    medians: Mapping[str, Interval | None]
    """Over solved problems, bootstrap intervals (percentiles of 2,000 resamples)."""


def list_tiers(rows: Sequence[ScoreRow]) -> list[tuple[str, list[ScoreRow]]]:
    """Return the tiers: all, by robots, by environment, by condition, by information."""
    return [tier for group in list_tier_groups(rows) for tier in group]


def list_tier_groups(rows: Sequence[ScoreRow]) -> list[list[tuple[str, list[ScoreRow]]]]:
    """Return the tiers of `list_tiers` by what they are a part of: five groups."""
    groups: list[list[tuple[str, list[ScoreRow]]]] = [[("all", list(rows))]]
    by_part: list[Callable[[ScoreRow], str]] = [
        lambda row: f"{row['robots']} robots" if row["robots"] > 1 else "1 robot",
        lambda row: str(row["set"]).split("-")[0],
        lambda row: str(row["set"]).split("-")[1],
        lambda row: str(row["set"]).split("-")[2],
    ]
    for part in by_part:
        names = dict.fromkeys(part(row) for row in rows)
        groups.append([(name, [row for row in rows if part(row) == name]) for name in names])
    return groups


def score_tiers(rows: Sequence[ScoreRow]) -> list[TierScore]:
    """Score all tiers of the rows of a result."""
    return [score_tier(name, part) for name, part in list_tiers(rows)]


def score_tier(name: str, rows: Sequence[ScoreRow]) -> TierScore:
    """Score some problems."""
    solved = [row for row in rows if row["solved"]]
    low, high = wilson_interval(len(solved), len(rows))
    robots = sum(row["robots"] for row in rows)
    return TierScore(
        name=name,
        problems=len(rows),
        solved=Interval(value=len(solved) / max(len(rows), 1), low=low, high=high, count=len(rows)),
        arrived=sum(row["arrived"] for row in rows) / max(robots, 1),
        medians={quantity: _median(quantity, solved) for quantity in MEDIANS},
    )


def _median(quantity: str, solved: Sequence[ScoreRow]) -> Interval | None:
    values = np.array(
        [value for row in solved if (value := measure(quantity, row)) is not None], float
    )
    if not len(values):
        return None
    rng = np.random.default_rng(SEED)
    resampled = np.median(rng.choice(values, (BOOTSTRAPS, len(values))), axis=1)
    low, high = np.percentile(resampled, [2.5, 97.5])
    return Interval(
        value=float(np.median(values)), low=float(low), high=float(high), count=len(values)
    )


def measure(quantity: str, row: ScoreRow) -> float | None:
    """Return a quantity of a solved problem; None if it is not known."""
    if quantity == "makespan_ratio":
        return float(row["makespan_s"]) / float(row["bound_s"])
    if quantity == "energy_j_per_robot":
        return float(row["energy_j"]) / float(row["robots"])
    value = row[quantity]
    return None if value is None else float(value)


def format_scores(result: Mapping[str, Any]) -> str:
    """Return the scores of a result as a text table, and why problems failed."""
    physics, planned = result["physics"], result.get("planned_on", {})
    lines = [
        f"{result['card']['name']}, {result['benchmark']}, flown by angler-mjx "
        f"{physics['angler-mjx']}; machine factor of planning {planned.get('factor', 1.0):.2f}",
        f"{'tier':<12}{'solved':>20}{'robots':>9}{'time':>8}{'energy':>9}{'gap':>8}{'planning':>10}",
        f"{'':<12}{'':>20}{'':>9}{'':>8}{'J':>9}{'m':>8}{'s':>10}",
    ]
    for tier in score_tiers(result["scores"]):
        medians = [tier.medians[name] for name in MEDIANS]
        texts = [f"{x.value:.3g}" if x is not None else "-" for x in medians]
        solved = tier.solved
        rate = f"{round(solved.value * tier.problems)}/{tier.problems} " + (
            f"({100 * solved.low:.0f}-{100 * solved.high:.0f} %)"
        )
        lines.append(
            f"{tier.name:<12}{rate:>20}{100 * tier.arrived:>7.0f} %"
            f"{texts[0]:>8}{texts[1]:>9}{texts[2]:>8}{texts[3]:>10}"
        )
    lines += [
        "",
        "solved: all robots arrived, with the 95 % interval; robots: that arrived; medians over "
        "solved",
        "problems: time over the straight line's, energy of a robot, least gap, planning time",
    ]
    failed = [row for row in result["scores"] if not row["solved"]]
    lines += [f"  {row['problem']}: {row['reason']}" for row in failed[:MAX_FAILED_LINES]]
    if len(failed) > MAX_FAILED_LINES:
        lines.append(f"  and {len(failed) - MAX_FAILED_LINES} more in result.json; the commonest:")
        reasons = count_reasons(result["scores"])
        lines += [f"  {count} x {reason}" for reason, count in reasons[:8]]
    return "\n".join(lines)


def count_reasons(rows: Sequence[ScoreRow]) -> list[tuple[str, int]]:
    """Return the reasons of unsolved problems without numbers of robots, the commonest first."""
    counts: dict[str, int] = {}
    for row in rows:
        if not row["solved"]:
            text = str(row["reason"])
            head, colon, rest = text.partition(": ")
            text = rest if colon and head.startswith("robot ") else text
            counts[text] = counts.get(text, 0) + 1
    return sorted(counts.items(), key=lambda item: (-item[1], item[0]))
