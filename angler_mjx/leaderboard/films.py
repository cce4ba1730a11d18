"""Films of the best and the worst flight of a checked submission."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import check_results
from angler_mjx.leaderboard.scores import measure
from angler_mjx.progress import Progress
from angler_mjx.report.video import write_video
from angler_mjx.runs import multi_run
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run

type ScoreRow = Mapping[str, Any]


def film_result(result: Path, out: Path, progress: Progress) -> Iterator[Path]:
    """Film the best and the worst flight of a check.

    Args:
        result: results folder with kept flights.
        out: folder of the films.
        progress: receives the progress, in frames.

    Yields:
        ``NAME-best-SET-PROBLEM.mp4`` and ``NAME-worst-SET-PROBLEM.mp4``; one of them alone where no
        other problem was flown.

    Raises:
        ConfigError: the folder holds no result, or no flights.
        UnsupportedError: no OpenGL works here, or PyAV is missing.
        RunError: a file cannot be written.
    """
    table = check_results.read_result(result)
    runs = result / multi_run.RUNS_FOLDER
    flown = [row for row in table["scores"] if (runs / row["set"] / TRAJECTORIES).is_dir()]
    if not flown:
        raise ConfigError(
            f"{result}: holds no trajectories; angler leaderboard check --keep-flights keeps them"
        )
    out.mkdir(parents=True, exist_ok=True)
    name = "".join(c if c.isalnum() else "_" for c in table["card"]["name"])
    for label, row in choose_flights(flown).items():
        world = int(row["problem"].rpartition("/")[2])
        path = out / f"{name}-{label}-{row['set']}-{world}.mp4"
        progress.describe(path.name)
        counted = 0

        def report(done: int, total: int) -> None:
            nonlocal counted
            if not counted:
                progress.start(total, unit="frames")
            progress.advance(done - counted)
            counted = done

        yield write_video(Run(runs / row["set"]), world, path, report=report)


def choose_flights(flown: list[ScoreRow]) -> dict[str, ScoreRow]:
    """Return the best and the worst of flown problems.

    The best is the solved one of the largest team with the least time over the straight line's. The
    worst is the unsolved one with the least fraction of arrived robots, then the largest team;
    plans that are late or have a fault are chosen where no others failed. If all are solved, it is
    the one with the most time over the straight line's. A single one is the best if it is solved,
    else the worst.

    Args:
        flown: rows of a result, not empty.
    """
    solved = [row for row in flown if row["solved"]]
    failed = [row for row in flown if not row["solved"]]
    chosen: dict[str, ScoreRow] = {}
    if solved:
        chosen["best"] = min(solved, key=lambda row: (-row["robots"], _time_ratio(row)))
    if failed:
        chosen["worst"] = min(
            failed,
            key=lambda row: (
                not str(row["reason"]).startswith("robot "),
                row["arrived"] / row["robots"],
                -row["robots"],
            ),
        )
    elif len(solved) > 1:
        others = [row for row in solved if row is not chosen["best"]]
        chosen["worst"] = max(others, key=_time_ratio)
    return chosen


def _time_ratio(row: ScoreRow) -> float:
    ratio = measure("makespan_ratio", row)
    assert ratio is not None
    return ratio
