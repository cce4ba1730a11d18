"""Value of a larger training set."""

import math
from dataclasses import replace
from pathlib import Path

from angler_experiments.learned_planner import checkpoint
from angler_experiments.learned_planner.evaluate import figure
from angler_experiments.learned_planner.evaluate.course import EvaluationCourse
from angler_experiments.learned_planner.evaluate.evaluation_log import (
    EvaluationKey,
    EvaluationLog,
    format_head,
    format_row,
)
from angler_experiments.learned_planner.evaluate.rows import find_sea, planner_table
from angler_experiments.learned_planner.progress import ProgressClock
from angler_experiments.learned_planner.train import example_files, loop
from angler_experiments.learned_planner.train.configs import CONFIGS

_WORLDS_PER_LEARNED = 20.0 / 19.0
"""Number of evaluated worlds for each training world."""


def evaluate_curve(
    out: Path,
    sizes: tuple[int, ...] = (1000, 10000, 100000),
    config: str = "small",
    steps: int | None = None,
    minutes: float | None = None,
    worlds: int = 128,
    planners: tuple[str, ...] = ("drawn", "learned"),
    samples: int = 16,
    seas: tuple[str, ...] = ("reef",),
    examples: Path | None = None,
) -> None:
    """Train on growing sets of worlds, and print the results of each.

    Args:
        out: Folder of the trainings, curve.json and curve.png; finished parts are not repeated.
        sizes: Worlds of the training sets; each is the beginning of the next.
        config: Config of `train`.
        steps: Steps, the same for all sizes; the config's if left out.
        minutes: Minutes of each training, by the pace of this machine: fewer steps, the same for
            all.
        worlds: Worlds of each evaluation.
        planners: By their names.
        samples: Paths sampled for each robot.
        seas: Seas of the evaluation.
        examples: File of examples, as in `train`; read if it exists, otherwise written.
    """
    report = ProgressClock()
    train_config = CONFIGS[config]
    train_config = replace(train_config, steps=steps or train_config.steps)
    all_examples = example_files.load_or_sample(
        train_config.sources, math.ceil(max(sizes) * _WORLDS_PER_LEARNED), examples, report
    )
    training_set, validation_set = loop.split_examples(all_examples)
    if training_set.count < max(sizes):
        report(f"there are {training_set.count} worlds to learn from, less than {max(sizes)}")
    if minutes is not None:
        train_config = loop.limit_steps(train_config, training_set, out, 60.0 * minutes, report)
    for size in sizes:
        report(f"training on {size} worlds, {train_config.steps} steps")
        loop.train(
            train_config,
            training_set,
            out / str(size),
            report,
            size=size,
            validation_set=validation_set,
        )
    log, shown_rows = EvaluationLog(out / "curve.json"), []
    for label in seas:
        keys: dict[str, EvaluationKey] = {}
        missing, loss = {}, {}
        for size in sizes:
            file = (out / str(size) / loop.WEIGHTS).absolute()
            loss[size] = checkpoint.load_checkpoint(file).about["loss"]
            for name in planners:
                row_name = f"{name}, {size}"
                keys[row_name] = EvaluationKey(
                    sea=label,
                    planner=name,
                    worlds=worlds,
                    learned_from=size,
                    steps=train_config.steps,
                    samples=samples,
                )
                if log.find(keys[row_name]) is None:
                    missing[row_name] = planner_table(name, checkpoint=str(file), samples=samples)
        if missing:
            course = EvaluationCourse(find_sea(label), worlds, report)
            for row_name, row in course.fly_all(missing):
                size = keys[row_name]["learned_from"]
                report(
                    f"{size}: "
                    f"{format_row(log.add(keys[row_name], row.table() | {'loss': loss[size]}))}"
                )
        shown_rows += [log.find(key) for key in keys.values()]
    first = [row for row in shown_rows if row and row["key"]["sea"] == seas[0]]
    report(str(figure.plot_curve(first, out / "curve.png")))
    header, rule = format_head().splitlines()
    print(f"| learned from {header}\n|---{rule}")
    table_lines = (f"| {row['key']['learned_from']} {format_row(row)}" for row in shown_rows if row)
    print("\n".join(table_lines), flush=True)
