"""Arrivals of each planner in each sea, and for each number of samples."""

from pathlib import Path
from typing import Literal

from angler_experiments.learned_planner import checkpoint as checkpoints
from angler_experiments.learned_planner.evaluate import figure, rows
from angler_experiments.learned_planner.evaluate.course import EvaluationCourse
from angler_experiments.learned_planner.evaluate.evaluation_log import (
    EvaluationKey,
    EvaluationLog,
    format_head,
    format_row,
)
from angler_experiments.learned_planner.planner import LearnedSettings
from angler_experiments.learned_planner.progress import ProgressClock
from angler_mjx.files import JsonTable


def evaluate_arrivals(
    seas: tuple[str, ...] = tuple(rows.SEAS),
    planners: tuple[str, ...] = rows.PLANNERS,
    worlds: int = 128,
    checkpoint: str = "",
    samples: tuple[int, ...] = (16,),
    ahead: tuple[int, ...] = (),
    told: Literal["nothing", "observed", "truth"] = "nothing",
    out: Path | None = None,
) -> None:
    """Print a row for each planner in each sea; all of a sea fly in the same worlds.

    Args:
        seas: By their labels.
        planners: By their names.
        worlds: Worlds of each row.
        checkpoint: File of the network; the shipped one if empty.
        samples: Paths sampled for each robot; a row for each number.
        ahead: More rows of ``learned``: numbers of teams, of which the best in a flight ahead is
            taken.
        told: Information level of the current for the flight ahead.
        out: Folder of arrivals.json, whose rows are not flown again, and arrivals.png.
    """
    report = ProgressClock()
    log = EvaluationLog(out / "arrivals.json" if out else None)
    file = Path(checkpoint).expanduser().absolute() if checkpoint else None
    network = checkpoints.hash_checkpoint(file)
    overrides = {"checkpoint": str(file)} if file else {}
    shown_rows = []
    for label in seas:
        keys: dict[str, EvaluationKey] = {}
        missing: dict[str, JsonTable] = {}
        for name in planners:
            for count in samples if rows.samples_paths(name) else samples[:1]:
                sample_settings = {"samples": count} if rows.samples_paths(name) else {}
                key = EvaluationKey(sea=label, planner=name, worlds=worlds)
                if rows.samples_paths(name):
                    key["samples"] = count
                if rows.uses_network(name):
                    key["checkpoint"] = network
                row_name = f"{name}, {count}"
                keys[row_name] = key
                if log.find(key) is None:
                    missing[row_name] = rows.planner_table(name, **overrides, **sample_settings)
        course = None
        if missing:
            course = EvaluationCourse(rows.find_sea(label), worlds, report)
            for row_name, row in course.fly_all(missing):
                entry = log.add(keys[row_name], row.table())
                report(
                    f"{format_row(entry)} compiled {row.compile_s:.0f} s, flown {row.flight_s:.0f} "
                    "s"
                )
        for teams in ahead:
            name = f"learned, {teams} ahead, told {told}"
            keys[name] = EvaluationKey(
                sea=label, planner=name, worlds=worlds, samples=samples[-1], checkpoint=network
            )
            if log.find(keys[name]) is None:
                course = course or EvaluationCourse(rows.find_sea(label), worlds, report)
                settings = LearnedSettings(
                    samples=samples[-1], checkpoint=overrides.get("checkpoint", "")
                )
                ahead_row = course.fly_ahead(settings, teams, told)
                report(format_row(log.add(keys[name], ahead_row.table())))
        shown_rows += [log.find(key) for key in keys.values()]
        if out:
            report(
                str(figure.plot_arrivals([row for row in shown_rows if row], out / "arrivals.png"))
            )
    print("\n".join([format_head(), *(format_row(row) for row in shown_rows if row)]), flush=True)


def evaluate_samples(
    seas: tuple[str, ...] = ("reef", "dense", "dense, 16 robots"),
    counts: tuple[int, ...] = (1, 2, 4, 16),
    planners: tuple[str, ...] = ("noise, not pushed", "learned, not pushed", "noise", "learned"),
    worlds: int = 128,
    checkpoint: str = "",
    out: Path | None = None,
) -> None:
    """Print the network's gain over noise, by the numbers of sampled paths and by the repair.

    Args:
        seas: By their labels.
        counts: Numbers of paths sampled for each robot.
        planners: By their names.
        worlds: Worlds of each row.
        checkpoint: File of the network; the shipped one if empty.
        out: Folder, as in `evaluate_arrivals`.
    """
    evaluate_arrivals(
        seas=seas, planners=planners, worlds=worlds, checkpoint=checkpoint, samples=counts, out=out
    )
