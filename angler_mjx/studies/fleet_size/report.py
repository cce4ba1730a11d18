"""What a study comes to: numbers of each size and condition, a row for each world, a page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from angler_mjx.runs.storage import atomic
from angler_mjx.studies.fleet_size import bernoulli, sequence, survival
from angler_mjx.studies.fleet_size.conditions import Condition, FleetSizeStudy
from angler_mjx.studies.fleet_size.sequence import Rule
from angler_mjx.studies.fleet_size.store import Batch

SHARES = {"median": 0.5, "p90": 0.9}
"""Quantiles of the time that a table shows, by name."""

SCHEMA = pa.schema(
    [
        pa.field("condition", pa.string(), metadata={"description": "its name"}),
        pa.field("size", pa.int32(), metadata={"description": "what size.key was set to"}),
        pa.field("world", pa.int64(), metadata={"description": "index of the world"}),
        pa.field("seed", pa.int64(), metadata={"description": "of the worlds"}),
        pa.field("success", pa.bool_(), metadata={"description": "done by the deadline"}),
        pa.field("completed_s", pa.float32(), metadata={"unit": "s", "description": "null: never"}),
        pa.field("arrived", pa.int32(), metadata={"description": "robots that did their part"}),
        pa.field("lost", pa.int32(), metadata={"description": "robots that ended otherwise"}),
        pa.field("energy_j", pa.float64(), metadata={"unit": "J", "description": "of the team"}),
        pa.field("path_m", pa.float64(), metadata={"unit": "m", "description": "of the team"}),
        pa.field("no_room", pa.bool_(), metadata={"description": "no room for the team"}),
    ]
)
"""Of ``results.parquet``."""


def gather(
    study: FleetSizeStudy, rule: Rule, batches: Sequence[Batch], ended: str
) -> dict[str, Any]:
    """All numbers of a study.

    Args:
        study: that was made.
        rule: of it.
        batches: that were flown.
        ended: how it ended.
    """
    config = study.config
    return {
        "name": config.name,
        "description": config.description,
        "scenario": config.scenario,
        "deadline_s": config.deadline_s,
        "probability": config.probability,
        "confidence": config.confidence,
        "levels": levels(rule),
        "within": config.within,
        "sizes": list(study.sizes),
        "span": not isinstance(config.sizes, tuple),
        "size_key": config.size.key,
        "seed": config.seed,
        "budget": config.budget.model_dump(mode="json"),
        "ended": ended,
        "complete": ended in ("answered", "most_worlds"),
        "worlds": sum(one.worlds for one in batches),
        "conditions": [
            _of_condition(study, rule, condition, batches) for condition in study.conditions
        ],
    }


def _of_condition(
    study: FleetSizeStudy, rule: Rule, condition: Condition, batches: Sequence[Batch]
) -> dict[str, Any]:
    deadline_s = study.config.deadline_s
    by_size: dict[int, list[Batch]] = {}
    for one in sorted(batches, key=lambda one: (one.size, one.first)):
        if one.condition == condition.name:
            by_size.setdefault(one.size, []).append(one)
    counts = {
        rule.sizes.index(size): (
            sum(one.hits(deadline_s) for one in several),
            sum(one.worlds for one in several),
        )
        for size, several in by_size.items()
    }
    found = sequence.answer(rule, counts)
    return {
        "name": condition.name,
        "values": dict(condition.values),
        "answer": {
            **asdict(found),
            "listed": list(found.listed),
            "text": found.text(rule.confidence),
        },
        "sizes": [_of_size(study, rule, condition, several) for several in by_size.values()],
    }


def _of_size(
    study: FleetSizeStudy, rule: Rule, condition: Condition, batches: Sequence[Batch]
) -> dict[str, Any]:
    """Success, times and costs of one size in one condition."""
    size = batches[0].size
    times = np.array(
        [math.inf if t is None else t for one in batches for t in one.completed_s], float
    )
    hits, total = int(np.sum(times <= study.config.deadline_s)), len(times)
    low, high = rule.ends(hits, total)
    horizon_s = study.scenario(condition, size).time.horizon_s
    curve = survival.curve(np.minimum(times, horizon_s), np.isfinite(times))
    alpha = 1.0 - rule.confidence
    planned = [x for one in batches for x in one.planned if x is not None]
    row: dict[str, Any] = {
        "size": size,
        "planned": sum(planned) / (size * len(planned)) if planned else None,
        "worlds": total,
        "met": hits,
        "rate": hits / total,
        "low": low,
        "high": high,
        "done": int(np.sum(np.isfinite(times))),
        "horizon_s": horizon_s,
        "mean_s": dict(
            zip(("mean", "low", "high"), survival.restricted_mean(curve, horizon_s), strict=True)
        ),
        "no_room": sum(sum(one.no_room) for one in batches),
        "lost_per_robot": float(np.mean([x for one in batches for x in one.lost])) / size,
        "energy_j": float(np.mean([x for one in batches for x in one.energy_j])),
        "path_m": float(np.mean([x for one in batches for x in one.path_m])),
    }
    for name, share in SHARES.items():
        values = bernoulli.quantile(times, share, alpha)
        row[f"{name}_s"] = {
            end: value if math.isfinite(value) else None
            for end, value in zip(("value", "low", "high"), values, strict=True)
        }
    return row


def write_results(path: Path, study: FleetSizeStudy, batches: Sequence[Batch]) -> None:
    """A row for each world, by condition, size and world."""
    order = {one.name: i for i, one in enumerate(study.conditions)}
    ordered = sorted(batches, key=lambda one: (order[one.condition], one.size, one.first))
    columns: dict[str, list[Any]] = {name: [] for name in SCHEMA.names}
    for one in ordered:
        columns["condition"] += [one.condition] * one.worlds
        columns["size"] += [one.size] * one.worlds
        columns["world"] += range(one.first, one.first + one.worlds)
        columns["seed"] += [study.config.seed] * one.worlds
        columns["success"] += [
            t is not None and t <= study.config.deadline_s for t in one.completed_s
        ]
        for name in ("completed_s", "arrived", "lost", "energy_j", "path_m", "no_room"):
            columns[name] += getattr(one, name)
    with atomic.whole(path) as writing:
        pq.write_table(pa.table(columns, schema=SCHEMA), writing)


ENDED = {
    "answered": "Every answer is as sharp as the file requires (within, in sizes of the file).",
    "most_worlds": "Some answers are open: a size may have no more worlds (budget.most_worlds).",
    "most_minutes": "The time was over (budget.most_minutes): --resume goes on.",
    "interrupted": "It was interrupted: --resume goes on.",
}
"""How a study ended, in words."""


def levels(rule: Rule) -> dict[str, float]:
    """Confidence of each kind of interval: of an answer, a size's share, a quantile, a mean.

    That of a share is of both ends of `sequence.Rule.ends` together.
    """
    half = 0.5 * (1.0 - rule.confidence)
    return {
        "answer": rule.confidence,
        "share": 1.0 - half - half / len(rule.sizes),
        "quantile": rule.confidence,
        "mean": survival.CONFIDENCE,
    }


def level(found: Mapping[str, Any], kind: str) -> str:
    """Confidence of a kind of interval of ``study.json``, in %."""
    return f"{100 * found['levels'][kind]:.4g} %"


def answers_table(found: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Head and rows: the answer of each condition."""
    sure = level(found, "answer")
    head = ["condition", "smallest team", f"{sure} interval", "worlds", "answer"]
    rows = []
    for one in found["conditions"]:
        known = one["answer"]
        low, high = known["low"], known["high"]
        top = found["sizes"][-1]
        span = f"{low} or more" if high is None else f"{low} to {high}"
        span = f"more than {top}" if low is None else span
        best = "none" if known["estimate"] is None else str(known["estimate"])
        rows.append([one["name"], best, span, f"{known['worlds']:,}", known["text"]])
    return head, rows


def sizes_table(
    found: Mapping[str, Any], one: Mapping[str, Any]
) -> tuple[list[str], list[list[str]]]:
    """Head and rows: the sizes of a condition that were flown.

    Args:
        found: as ``study.json`` holds it.
        one: of its conditions.
    """
    probability, quantile = found["probability"], level(found, "quantile")
    head = [
        "robots",
        "worlds",
        "met the deadline",
        f"{level(found, 'share')} interval",
        "decided",
        "robots with a plan",
        f"median time ({quantile} interval), s",
        f"90 % of worlds by ({quantile} interval), s",
        f"mean to the horizon ({level(found, 'mean')} interval), s",
        "robots lost",
        "energy, kJ",
    ]
    rows = []
    for row in one["sizes"]:
        decided = "open"
        if row["low"] >= probability:
            decided = "enough"
        elif row["high"] < probability:
            decided = "too few"
        mean = row["mean_s"]
        rows.append(
            [
                str(row["size"]),
                f"{row['worlds']:,}",
                f"{100 * row['rate']:.2f} %",
                f"{100 * row['low']:.2f} to {100 * row['high']:.2f} %",
                decided,
                "-" if row.get("planned") is None else f"{100 * row['planned']:.1f} %",
                _time(row["median_s"]),
                _time(row["p90_s"]),
                f"{mean['mean']:.1f} ({mean['low']:.1f} to {mean['high']:.1f})",
                f"{100 * row['lost_per_robot']:.2f} %",
                f"{row['energy_j'] / 1000:.1f}",
            ]
        )
    return head, rows


def _time(row: Mapping[str, float | None]) -> str:
    def one(value: float | None) -> str:
        return "never" if value is None else f"{value:.1f}"

    return f"{one(row['value'])} ({one(row['low'])} to {one(row['high'])})"


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for a page."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_page(path: Path, found: Mapping[str, Any]) -> None:
    """The page of a study."""
    p, sure = f"{100 * found['probability']:g} %", level(found, "answer")
    none = sum(row["no_room"] for one in found["conditions"] for row in one["sizes"])
    parts = [
        f"# {found['name']}",
        found["description"],
        f"Smallest team that is done within {found['deadline_s']:g} s with a probability of {p}, "
        f"in {found['worlds']:,} worlds of scenario {found['scenario']}. {ENDED[found['ended']]}",
        markdown(*answers_table(found)),
        f"The interval holds the smallest such number of robots with {sure}, for each condition "
        "by itself, however long was flown (docs/fleet_size.md says why). Of sizes that were not "
        "flown, one counts as too few where the next larger one that was, and all below, are.",
        "![success](success.png)",
        "![time](time.png)",
        f"Intervals of shares ({level(found, 'share')}, each size by itself) decide whether a size "
        "is enough, and hold however long was flown. Times: of all worlds, also those that were "
        f"never done; intervals of quantiles ({level(found, 'quantile')}) hold however long was "
        f"flown, those of means ({level(found, 'mean')}) for a number of worlds that was fixed "
        "beforehand."
        + (f" In {none:,} worlds there was no room for the team: not done." if none else ""),
    ]
    for one in found["conditions"]:
        parts += [f"## {one['name']}", markdown(*sizes_table(found, one))]
    took = found["timing"]
    made = found["environment"]
    parts.append(
        f"Made in {took['total_s']:.0f} s, {took['compiled']} programs compiled, on "
        f"{made['device']}: `{made['command']}`, commit {made['commit']}."
    )
    atomic.write_text(path, "\n\n".join(part for part in parts if part) + "\n")
