"""What a study comes to: numbers of each size and condition, a row for each world, a page."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np
import pyarrow as pa

from angler_mjx.report.viewing.markdown_tables import format_table
from angler_mjx.runs.storage import atomic_files
from angler_mjx.studies.fleet_size import bernoulli, sequential_test, survival
from angler_mjx.studies.fleet_size.conditions import Condition, FleetSizeStudy
from angler_mjx.studies.fleet_size.sequential_test import SequentialRule
from angler_mjx.studies.fleet_size.store import Batch

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
        pa.field(
            "path_length_m", pa.float64(), metadata={"unit": "m", "description": "of the team"}
        ),
        pa.field("no_room", pa.bool_(), metadata={"description": "no room for the team"}),
    ]
)
"""Of ``results.parquet``."""


class QuantileRow(TypedDict):
    """A quantile of the time [s] with its interval; None: never."""

    value: float | None
    low: float | None
    high: float | None


class SizeRow(TypedDict):
    """One size of the team in one condition."""

    size: int
    planned: float | None
    """Fraction of robots with a plan; None without planning."""
    worlds: int
    met: int
    """Worlds that were done by the deadline."""
    rate: float
    low: float
    high: float
    done: int
    """Worlds that were done at all."""
    horizon_s: float
    mean_s: dict[str, float]
    """Mean to the horizon, and the ends ``low`` and ``high`` of its interval."""
    no_room: int
    lost_per_robot: float
    energy_j: float
    path_length_m: float
    median_s: QuantileRow
    p90_s: QuantileRow


class AnswerRow(TypedDict):
    """The answer of a condition, as `sequential_test.SizeAnswer`, and in words."""

    estimate: int | None
    low: int | None
    high: int | None
    good: bool
    worlds: int
    largest: int
    listed: list[int]
    text: str


class ConditionRow(TypedDict):
    """One condition."""

    name: str
    values: dict[str, object]
    answer: AnswerRow
    sizes: list[SizeRow]


class FleetSizeResults(TypedDict):
    """Contents of ``study.json``."""

    name: str
    description: str
    scenario: str
    deadline_s: float
    probability: float
    confidence: float
    levels: dict[str, float]
    within: float
    sizes: list[int]
    span: bool
    size_key: str
    seed: int
    budget: dict[str, object]
    ended: str
    complete: bool
    worlds: int
    conditions: list[ConditionRow]
    tile: NotRequired[int]
    environment: NotRequired[Mapping[str, object]]
    """Written with the file: command, commit, device."""
    timing: NotRequired[Mapping[str, float]]
    """Written with the file: seconds in all, programs compiled."""


def gather_results(
    study: FleetSizeStudy, rule: SequentialRule, batches: Sequence[Batch], ended: str
) -> FleetSizeResults:
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
        "levels": confidence_levels(rule),
        "within": config.within,
        "sizes": list(study.sizes),
        "span": not isinstance(config.sizes, tuple),
        "size_key": config.size.key,
        "seed": config.seed,
        "budget": config.budget.model_dump(mode="json"),
        "ended": ended,
        "complete": ended in ("answered", "max_worlds"),
        "worlds": sum(batch.worlds for batch in batches),
        "conditions": [
            _summarise_condition(study, rule, condition, batches) for condition in study.conditions
        ],
    }


def _summarise_condition(
    study: FleetSizeStudy, rule: SequentialRule, condition: Condition, batches: Sequence[Batch]
) -> ConditionRow:
    deadline_s = study.config.deadline_s
    by_size: dict[int, list[Batch]] = {}
    for batch in sorted(batches, key=lambda batch: (batch.size, batch.first)):
        if batch.condition == condition.name:
            by_size.setdefault(batch.size, []).append(batch)
    counts = {
        rule.sizes.index(size): (
            sum(batch.hits(deadline_s) for batch in size_batches),
            sum(batch.worlds for batch in size_batches),
        )
        for size, size_batches in by_size.items()
    }
    answer = sequential_test.build_answer(rule, counts)
    return {
        "name": condition.name,
        "values": dict(condition.values),
        "answer": {
            "estimate": answer.estimate,
            "low": answer.low,
            "high": answer.high,
            "good": answer.good,
            "worlds": answer.worlds,
            "largest": answer.largest,
            "listed": list(answer.listed),
            "text": answer.text(rule.confidence),
        },
        "sizes": [
            _summarise_size(study, rule, condition, size_batches)
            for size_batches in by_size.values()
        ],
    }


def _summarise_size(
    study: FleetSizeStudy, rule: SequentialRule, condition: Condition, batches: Sequence[Batch]
) -> SizeRow:
    """Success, times and costs of one size in one condition."""
    size = batches[0].size
    times = np.array(
        [math.inf if t is None else t for batch in batches for t in batch.completed_s], float
    )
    hits, total = int(np.sum(times <= study.config.deadline_s)), len(times)
    low, high = rule.ends(hits, total)
    horizon_s = study.scenario(condition, size).time.horizon_s
    curve = survival.estimate_curve(np.minimum(times, horizon_s), np.isfinite(times))
    alpha = 1.0 - rule.confidence
    planned = [x for batch in batches for x in batch.planned if x is not None]
    return {
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
        "no_room": sum(sum(batch.no_room) for batch in batches),
        "lost_per_robot": float(np.mean([x for batch in batches for x in batch.lost])) / size,
        "energy_j": float(np.mean([x for batch in batches for x in batch.energy_j])),
        "path_length_m": float(np.mean([x for batch in batches for x in batch.path_length_m])),
        "median_s": _estimate_quantile(times, 0.5, alpha),
        "p90_s": _estimate_quantile(times, 0.9, alpha),
    }


def _estimate_quantile(times_s: np.ndarray, fraction: float, alpha: float) -> QuantileRow:
    """Return a quantile of times [n], and its interval of confidence 1 - alpha."""
    value, low, high = (
        end if math.isfinite(end) else None
        for end in bernoulli.estimate_quantile(times_s, fraction, alpha)
    )
    return {"value": value, "low": low, "high": high}


def write_results(path: Path, study: FleetSizeStudy, batches: Sequence[Batch]) -> None:
    """A row for each world, by condition, size and world."""
    order = {batch.name: i for i, batch in enumerate(study.conditions)}
    ordered = sorted(batches, key=lambda batch: (order[batch.condition], batch.size, batch.first))
    columns: dict[str, list[object]] = {name: [] for name in SCHEMA.names}
    for batch in ordered:
        columns["condition"] += [batch.condition] * batch.worlds
        columns["size"] += [batch.size] * batch.worlds
        columns["world"] += range(batch.first, batch.first + batch.worlds)
        columns["seed"] += [study.config.seed] * batch.worlds
        columns["success"] += [
            t is not None and t <= study.config.deadline_s for t in batch.completed_s
        ]
        for name in ("completed_s", "arrived", "lost", "energy_j", "path_length_m", "no_room"):
            columns[name] += getattr(batch, name)
    atomic_files.write_parquet(path, pa.table(columns, schema=SCHEMA))


ENDING_TEXTS = {
    "answered": "Every answer is as sharp as the file requires (within, in sizes of the file).",
    "max_worlds": "Some answers are open: a size may have no more worlds (budget.max_worlds).",
    "max_minutes": "The time was over (budget.max_minutes): --resume goes on.",
    "interrupted": "It was interrupted: --resume goes on.",
}
"""How a study ended, in words."""


def confidence_levels(rule: SequentialRule) -> dict[str, float]:
    """Confidence of each kind of interval: of an answer, a size's share, a quantile, a mean.

    That of a share is of both ends of `sequential_test.SequentialRule` together.
    """
    half = 0.5 * (1.0 - rule.confidence)
    return {
        "answer": rule.confidence,
        "share": 1.0 - half - half / len(rule.sizes),
        "quantile": rule.confidence,
        "mean": survival.CONFIDENCE,
    }


def format_level(results: FleetSizeResults, kind: str) -> str:
    """Confidence of a kind of interval of ``study.json``, in %."""
    return f"{100 * results['levels'][kind]:.4g} %"


def answers_table(results: FleetSizeResults) -> tuple[list[str], list[list[str]]]:
    """Head and rows: the answer of each condition."""
    sure = format_level(results, "answer")
    head = ["condition", "smallest team", f"{sure} interval", "worlds", "answer"]
    rows = []
    for condition in results["conditions"]:
        answer = condition["answer"]
        low, high = answer["low"], answer["high"]
        top = results["sizes"][-1]
        span = f"{low} or more" if high is None else f"{low} to {high}"
        span = f"more than {top}" if low is None else span
        best = "none" if answer["estimate"] is None else str(answer["estimate"])
        rows.append([condition["name"], best, span, f"{answer['worlds']:,}", answer["text"]])
    return head, rows


def sizes_table(
    results: FleetSizeResults, condition: ConditionRow
) -> tuple[list[str], list[list[str]]]:
    """Head and rows: the sizes of a condition that were flown.

    Args:
        results: as ``study.json`` holds it.
        condition: of its conditions.
    """
    probability, quantile = results["probability"], format_level(results, "quantile")
    head = [
        "robots",
        "worlds",
        "met the deadline",
        f"{format_level(results, 'share')} interval",
        "decided",
        "robots with a plan",
        f"median time ({quantile} interval), s",
        f"90 % of worlds by ({quantile} interval), s",
        f"mean to the horizon ({format_level(results, 'mean')} interval), s",
        "robots lost",
        "energy, kJ",
    ]
    rows = []
    for row in condition["sizes"]:
        decided = "open"
        if row["low"] >= probability:
            decided = "enough"
        elif row["high"] < probability:
            decided = "too few"
        mean, planned = row["mean_s"], row.get("planned")
        rows.append(
            [
                str(row["size"]),
                f"{row['worlds']:,}",
                f"{100 * row['rate']:.2f} %",
                f"{100 * row['low']:.2f} to {100 * row['high']:.2f} %",
                decided,
                "-" if planned is None else f"{100 * planned:.1f} %",
                _format_time(row["median_s"]),
                _format_time(row["p90_s"]),
                f"{mean['mean']:.1f} ({mean['low']:.1f} to {mean['high']:.1f})",
                f"{100 * row['lost_per_robot']:.2f} %",
                f"{row['energy_j'] / 1000:.1f}",
            ]
        )
    return head, rows


def _format_time(row: QuantileRow) -> str:
    def format_value(value: float | None) -> str:
        return "never" if value is None else f"{value:.1f}"

    return (
        f"{format_value(row['value'])} ({format_value(row['low'])} to {format_value(row['high'])})"
    )


def _format_text_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return format_table(head, rows, text=range(len(head)))


def write_page(path: Path, results: FleetSizeResults) -> None:
    """The page of a study."""
    p, level_text = f"{100 * results['probability']:g} %", format_level(results, "answer")
    none = sum(row["no_room"] for condition in results["conditions"] for row in condition["sizes"])
    parts = [
        f"# {results['name']}",
        results["description"],
        f"Smallest team that is done within {results['deadline_s']:g} s with a probability of {p}, "
        f"in {results['worlds']:,} worlds of scenario {results['scenario']}. "
        f"{ENDING_TEXTS[results['ended']]}",
        _format_text_table(*answers_table(results)),
        f"The interval holds the smallest such number of robots with {level_text}, for each "
        "condition "
        "by itself, however long was flown (docs/explanation/fleet_size.md). Of sizes that were "
        "not flown, one counts as too few where the next larger one that was, and all below, are.",
        "![success](success.png)",
        "![time](time.png)",
        f"Intervals of shares ({format_level(results, 'share')}, each size by itself) decide "
        "whether a size "
        "is enough, and hold however long was flown. Times: of all worlds, also those that were "
        f"never done; intervals of quantiles ({format_level(results, 'quantile')}) hold however "
        "long was "
        f"flown, those of means ({format_level(results, 'mean')}) for a number of worlds that was "
        "fixed "
        "beforehand."
        + (f" In {none:,} worlds there was no room for the team: not done." if none else ""),
    ]
    for condition in results["conditions"]:
        parts += [
            f"## {condition['name']}",
            _format_text_table(*sizes_table(results, condition)),
        ]
    timing = results["timing"]
    environment = results["environment"]
    parts.append(
        f"Made in {timing['total_s']:.0f} s, {timing['compiled']} programs compiled, on "
        f"{environment['device']}: `{environment['command']}`, commit {environment['commit']}."
    )
    atomic_files.write_text(path, "\n\n".join(part for part in parts if part) + "\n")
