"""What a larger training set is worth."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from angler_experiments.learned_planner import checkpoint, train
from angler_experiments.learned_planner.evaluate import figure
from angler_experiments.learned_planner.evaluate.book import EvaluationLog, head, line
from angler_experiments.learned_planner.evaluate.course import EvaluationCourse
from angler_experiments.learned_planner.evaluate.rows import sea, table
from angler_experiments.learned_planner.progress import Clock
from angler_experiments.learned_planner.training import keeping, loop

_WITH_HELD = 20.0 / 19.0
"""Worlds in all for each that is learned from."""


def curve(
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
    """Train on more and more worlds, and print what each is worth.

    Args:
        out: Folder of the trainings, curve.json and curve.png; what is there is not done again.
        sizes: Worlds of the training sets; each is the beginning of the next.
        config: Of `train`.
        steps: Instead of the config's; the same for all sizes.
        minutes: Of each training, by the pace of this machine: fewer steps, the same for all.
        worlds: That each is judged in.
        planners: By their names.
        samples: Ways drawn for each robot.
        seas: To be judged in.
        examples: File of examples, as of `train`; read if it is there, otherwise written.
    """
    tell = Clock()
    chosen = train.CONFIGS[config]
    chosen = replace(chosen, steps=steps or chosen.steps)
    whole = keeping.examples(chosen.sources, math.ceil(max(sizes) * _WITH_HELD), examples, tell)
    learned, held = loop.divided(whole)
    if learned.count < max(sizes):
        tell(f"there are {learned.count} worlds to learn from, less than {max(sizes)}")
    if minutes is not None:
        chosen = loop.paced(chosen, learned, out, 60.0 * minutes, tell)
    for size in sizes:
        tell(f"training on {size} worlds, {chosen.steps} steps")
        loop.train(chosen, learned, out / str(size), tell, size=size, held=held)
    book, shown = EvaluationLog(out / "curve.json"), []
    for label in seas:
        keys: dict[str, dict[str, Any]] = {}
        left, loss = {}, {}
        for size in sizes:
            file = (out / str(size) / loop.WEIGHTS).absolute()
            loss[size] = checkpoint.load(file).about["loss"]
            for name in planners:
                of = {"learned_from": size, "steps": chosen.steps, "samples": samples}
                one = f"{name}, {size}"
                keys[one] = {"sea": label, "planner": name, "worlds": worlds} | of
                if book.find(keys[one]) is None:
                    left[one] = table(name, checkpoint=str(file), samples=samples)
        if left:
            course = EvaluationCourse(sea(label), worlds, tell)
            for one, row in course.fly_all(left):
                size = keys[one]["learned_from"]
                tell(f"{size}: {line(book.add(keys[one], row.table() | {'loss': loss[size]}))}")
        shown += [book.find(key) for key in keys.values()]
    first = [row for row in shown if row and row["key"]["sea"] == seas[0]]
    tell(str(figure.curve(first, out / "curve.png")))
    top, rule = head().splitlines()
    print(f"| learned from {top}\n|---{rule}")
    each = (f"| {row['key']['learned_from']} {line(row)}" for row in shown if row)
    print("\n".join(each), flush=True)
