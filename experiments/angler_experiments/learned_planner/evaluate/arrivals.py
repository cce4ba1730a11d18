"""A row for each planner in each sea, and for each number of samples."""

from pathlib import Path
from typing import Any, Literal

from angler_experiments.learned_planner import checkpoint as checkpoints
from angler_experiments.learned_planner.evaluate import figure, rows
from angler_experiments.learned_planner.evaluate.book import EvaluationLog, head, line
from angler_experiments.learned_planner.evaluate.course import EvaluationCourse
from angler_experiments.learned_planner.progress import Clock


def arrivals(
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
        worlds: Of each row.
        checkpoint: Of the network; the shipped one if empty.
        samples: Ways drawn for each robot; a row for each number.
        ahead: More rows of ``learned``: of so many teams, the best in a flight ahead.
        told: What is known of the current to the flight ahead.
        out: Folder of arrivals.json, whose rows are not flown again, and arrivals.png.
    """
    tell = Clock()
    book = EvaluationLog(out / "arrivals.json" if out else None)
    file = Path(checkpoint).expanduser().absolute() if checkpoint else None
    network = {"checkpoint": checkpoints.digest(file)}
    given = {"checkpoint": str(file)} if file else {}
    shown = []
    for label in seas:
        keys: dict[str, dict[str, Any]] = {}
        left: dict[str, dict[str, Any]] = {}
        for name in planners:
            for count in samples if rows.draws(name) else samples[:1]:
                of_samples = {"samples": count} if rows.draws(name) else {}
                key = {"sea": label, "planner": name, "worlds": worlds} | of_samples
                key |= network if rows.learned(name) else {}
                one = f"{name}, {count}"
                keys[one] = key
                if book.find(key) is None:
                    left[one] = rows.table(name, **given, **of_samples)
        course = None
        if left:
            course = EvaluationCourse(rows.sea(label), worlds, tell)
            for one, row in course.fly_all(left):
                made = book.add(keys[one], row.table())
                tell(f"{line(made)} compiled {row.compile_s:.0f} s, flown {row.flight_s:.0f} s")
        for teams in ahead:
            name = f"learned, {teams} ahead, told {told}"
            key = {"sea": label, "planner": name, "worlds": worlds, "samples": samples[-1]}
            keys[name] = key | network
            if book.find(keys[name]) is None:
                course = course or EvaluationCourse(rows.sea(label), worlds, tell)
                flown = course.fly_ahead(given | {"samples": samples[-1]}, teams, told)
                tell(line(book.add(keys[name], flown.table())))
        shown += [book.find(key) for key in keys.values()]
        if out:
            tell(str(figure.arrivals([row for row in shown if row], out / "arrivals.png")))
    print("\n".join([head(), *(line(row) for row in shown if row)]), flush=True)


def samples(
    seas: tuple[str, ...] = ("reef", "dense", "dense, 16 robots"),
    counts: tuple[int, ...] = (1, 2, 4, 16),
    planners: tuple[str, ...] = ("noise, not pushed", "learned, not pushed", "noise", "learned"),
    worlds: int = 128,
    checkpoint: str = "",
    out: Path | None = None,
) -> None:
    """Print what the network is worth beside noise, by the number of ways drawn and by the repair.

    Args:
        seas: By their labels.
        counts: Of ways drawn for each robot.
        planners: By their names.
        worlds: Of each row.
        checkpoint: Of the network; the shipped one if empty.
        out: Folder, as of `arrivals`.
    """
    arrivals(
        seas=seas, planners=planners, worlds=worlds, checkpoint=checkpoint, samples=counts, out=out
    )
