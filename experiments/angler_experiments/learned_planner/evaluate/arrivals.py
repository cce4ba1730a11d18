"""A row for each planner in each sea."""

from pathlib import Path
from typing import Any

from angler_experiments.learned_planner import checkpoint as checkpoints
from angler_experiments.learned_planner.evaluate import figure
from angler_experiments.learned_planner.evaluate.book import Book, head, line
from angler_experiments.learned_planner.evaluate.course import Course
from angler_experiments.learned_planner.evaluate.rows import PLANNERS, SEAS, sea, table
from angler_experiments.learned_planner.telling import Clock

DRAWING = ("drawn", "noise", "learned")
"""Rows that draw samples."""


def arrivals(
    seas: tuple[str, ...] = tuple(SEAS),
    rows: tuple[str, ...] = PLANNERS,
    worlds: int = 128,
    checkpoint: str = "",
    samples: int = 16,
    out: Path | None = None,
) -> None:
    """Print a row for each planner in each sea; all of a sea fly in the same worlds.

    Args:
        seas: By their labels.
        rows: Planners.
        worlds: Of each row.
        checkpoint: Of the network; the shipped one if empty.
        samples: Ways drawn for each robot.
        out: Folder of arrivals.json, whose rows are not flown again, and arrivals.png.
    """
    tell = Clock()
    book = Book(out / "arrivals.json" if out else None)
    file = Path(checkpoint).expanduser().absolute() if checkpoint else None
    digest = checkpoints.digest(file) if set(rows) & {"drawn", "learned"} else ""
    drawing = {"samples": samples} | ({"checkpoint": str(file)} if file else {})
    shown = []
    for label in seas:
        keys: dict[str, dict[str, Any]] = {}
        for name in rows:
            of_network = {"checkpoint": digest} if name in ("drawn", "learned") else {}
            of_samples = {"samples": samples} if name in DRAWING else {}
            keys[name] = {"sea": label, "planner": name, "worlds": worlds} | of_network | of_samples
        left = {n: table(n, **drawing) for n in rows if book.find(keys[n]) is None}
        if left:
            course = Course(sea(label), worlds, tell)
            for name, row in course.fly_all(left):
                made = book.add(keys[name], row.table())
                tell(f"{line(made)} compiled {row.compile_s:.0f} s, flown {row.flight_s:.0f} s")
        shown += [book.find(keys[name]) for name in rows]
        if out:
            tell(str(figure.arrivals([row for row in shown if row], out / "arrivals.png")))
    print("\n".join([head(), *(line(row) for row in shown if row)]), flush=True)
