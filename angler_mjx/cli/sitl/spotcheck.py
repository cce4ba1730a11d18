"""`angler spotcheck`: episodes of a run or a dataset, flown again by real ArduSub autopilots."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import tyro

from angler_mjx.cli.shared.device import choose_device, keep_all_programs
from angler_mjx.cli.shared.progress import ProgressBar
from angler_mjx.errors import ConfigError, UnsupportedError


def spotcheck(
    run: Annotated[Path, tyro.conf.Positional],
    episodes: int = 8,
    stratify: Literal["outcome", "none"] = "outcome",
    against: tuple[Literal["surrogate", "cascade"], ...] = ("surrogate", "cascade"),
    level: tuple[Literal["guided", "thrusters"], ...] = ("thrusters", "guided"),
    robots: tuple[int, ...] = (),
    source: Literal["vision", "vicon", "gps"] = "vision",
    speed: str = "max",
    seed: int = 0,
    ardusub: Path | None = None,
    out: Path | None = None,
    resume: bool = False,
    isolate: bool = False,
) -> None:
    """Fly episodes of a run or a dataset again with real ArduSub autopilots, and report the gap.

    Worlds are made again from the run's scenario and seed, and compared with its records. The same
    plans are flown at each level; where the run replanned in flight, so do the autopilots, from
    their own estimates. The folder holds report.md with figures, gaps.csv, and every flight. Of a
    dataset episodes of all parts are flown, each part in a folder of its own, and the results are
    written into the dataset: spotcheck.json, and its card.

    Args:
        run: Run folder of angler rollout, with trajectories; or a dataset.
        episodes: Number of worlds, over all parts of a dataset.
        stratify: Sampling of worlds: outcome includes rare outcomes; none samples uniformly.
        against: Fly them again in the batch simulator too, with the surrogate of ArduSub, the
            cascade, or both. The run's records are always compared.
        level: Command level of the autopilots: thruster signals, or position targets.
        robots: Number of robots to fly, the first of each world; several numbers are flown in
            sequence. All robots if left out.
        source: Position source of the autopilots' filters.
        speed: Max speed as a multiple of real time, or max.
        seed: Seed of the sampling of worlds.
        ardusub: ArduSub binary; if left out, that of ANGLER_ARDUSUB, else the installed one.
        out: Folder to make; RUN-spotcheck if left out.
        resume: Continue an interrupted spot check in the same folder, with the same arguments.
        isolate: Run in a network namespace, where no socket can be reached from outside.
    """
    if find_spec("pymavlink") is None:
        raise UnsupportedError("real autopilots need pymavlink: pip install 'angler-mjx[sitl]'")
    if isolate:
        from angler_sitl.firmware import isolation

        isolation.isolate_network()
    choose_device(None)
    keep_all_programs()
    from angler_mjx.learning.datasets.manifest import MANIFEST
    from angler_sitl.scene.motion import compute_inline
    from angler_sitl.spotcheck import dataset as of_dataset
    from angler_sitl.spotcheck import report_page, runner
    from angler_sitl.spotcheck.results import SpotcheckSettings

    compute_inline()
    settings = SpotcheckSettings(
        episodes=episodes,
        stratify=stratify,
        seed=seed,
        against=tuple(dict.fromkeys(against)),
        levels=tuple(dict.fromkeys(level)),
        robots=robots,
        source=source,
        speed=_parse_speed(speed),
        binary=ardusub,
    )
    out_path = out or run.with_name(f"{run.resolve().name}-spotcheck")
    if (run / MANIFEST).is_file():
        with ProgressBar() as bar:
            report = of_dataset.check_dataset(run, settings, out_path, bar, resume=resume)
        for row in () if report is None else report.rows:
            _print_agreement(
                f"{row.flown_by}, against {row.against}",
                (row.agree, row.robots),
                row.track_rms_m[0],
                row.path_rms_m[0],
            )
        if report is not None and report.left_out:
            print(f"not checked, nothing was flown of them: {', '.join(report.left_out)}")
        _print_result(out_path, complete=report is not None)
        return
    with ProgressBar() as bar:
        results = runner.run_spot_check(run, settings, out_path, bar, resume=resume)
    for name, count, reference, comparison in report_page.summarise_rows(results):
        _print_agreement(
            f"{name}, {count} robots, against {reference}",
            (comparison.agree, comparison.robots),
            comparison.track_rms_m[0],
            comparison.path_rms_m[0],
        )
    _print_result(out_path, complete=results.complete)


def _print_agreement(
    label: str, agree: tuple[int, int], track_m: float | None, path_m: float | None
) -> None:
    """Print a line: number of robots, number with equal outcomes, and two medians."""
    track_text, path_text = (
        "-" if value is None else f"{value:.2f} m" for value in (track_m, path_m)
    )
    print(
        f"{label}: {agree[0]} of {agree[1]} ended the same way; track {track_text}, way "
        f"{path_text} (medians)"
    )


def _print_result(path: Path, *, complete: bool) -> None:
    print(path)
    if not complete:
        print("interrupted: go on with --resume", file=sys.stderr)
        sys.exit(130)


def _parse_speed(text: str) -> Literal["max"] | float:
    if text == "max":
        return "max"
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"--speed {text}: give a positive number, or max") from None
