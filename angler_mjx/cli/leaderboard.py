"""`angler leaderboard`: the frozen benchmark ANGLER-1, submissions and their board."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from angler_mjx.cli.shared.device import Device, choose_device, keep_all_programs
from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.leaderboard.problem_files import ProblemManifest

type Sets = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]


def write_problems(
    out: Path = Path("problems/angler_1"),
    sets: Sets = (),
    secret: Path | None = None,
    device: Device | None = None,
) -> None:
    """Write the problems of ANGLER-1 as files that need no code of this package.

    A repeated call keeps the sets that are there.

    Args:
        out: Folder to make.
        sets: A set such as reef-still-known-04, or parts of names such as reef-04; all if left out.
        secret: File whose bytes an organiser keeps: makes problems that nobody has seen, with the
            same rules. Its SHA-256 is printed; publish that.
        device: Device to sample the worlds on; JAX's choice if left out.
    """
    choose_device(device)
    keep_all_programs()
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.leaderboard import problem_files, problem_sets

    benchmark, hidden = problem_sets.load_benchmark(), _read_secret(secret)
    frozen = None if secret is not None else problem_files.public_manifest()
    with ProgressBar() as bar:
        manifest = problem_files.write_problem_files(
            benchmark,
            problem_sets.select_problem_sets(benchmark, sets),
            out,
            bar,
            secret=hidden,
            frozen=frozen,
        )
    if secret is not None:
        print(f"secret: SHA-256 {problem_sets.digest_secret(hidden)}")
    print(f"{manifest.problems} problems, SHA-256 {manifest.sha256()}")
    print(out)


def plan(
    planner: str,
    out: Path,
    name: str | None = None,
    sets: Sets = (),
    problems: Path | None = None,
    secret: Path | None = None,
    workers: int | None = None,
    processes: int | None = None,
    device: Device | None = None,
) -> None:
    """Plan the problems with a planner of the package or a file, into a submission.

    A repeated call goes on after an interruption.

    Args:
        planner: Planner of angler plan --list, with the settings of its baseline, or FILE.py:CLASS.
        out: Folder of the submission.
        name: Name on the board; the planner's if left out.
        sets: A set such as reef-still-known-04, or parts of names such as reef-04; all if left out.
        problems: Folder of hidden problems; the public ones if left out.
        secret: File that hidden problems were made with.
        workers: Number of planning processes, for planners on the host; one for each processor if
            left out.
        processes: Processes that compile planners side by side for the device, where they are
            called one by one; on a GPU half of the processors, at most 8, else 1, if left out.
        device: Device to sample the worlds and plan on; JAX's choice if left out.
    """
    count = _begin_processes(device, processes)
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.leaderboard.baselines import planner_table
    from angler_mjx.leaderboard.entering import plan_submission

    planning = require_positive("workers", workers)
    manifest, hidden = _find_problems(problems, secret)
    with ProgressBar() as bar:
        plan_submission(
            out,
            planner_table(planner),
            bar,
            manifest=manifest,
            name=name or planner,
            sets=sets,
            secret=hidden,
            workers=planning,
            processes=count,
        )
    print(out)


def check(
    submission: Annotated[Path, tyro.conf.Positional],
    out: Path | None = None,
    sets: Sets = (),
    problems: Path | None = None,
    secret: Path | None = None,
    resume: bool = False,
    keep_flights: bool = False,
    processes: int | None = None,
    device: Device | None = None,
) -> None:
    """Judge a submission: fly its plans in truth, and have the referee compute all scores.

    Args:
        submission: Folder with card.toml and plans; see docs/reference/angler_1.md.
        out: Results folder to make; runs/NAME of the submission's folder if left out.
        sets: Judge only these, such as reef-still-known-04 or reef-04; all that the card enters if
            left out.
        problems: Folder of hidden problems; the public ones if left out.
        secret: File that hidden problems were made with.
        resume: Continue an interrupted check.
        keep_flights: Keep the trajectories, for angler replay.
        processes: Processes that compile and fly side by side on the device; on a GPU half of the
            processors, at most 8, else 1, if left out.
        device: Device to fly on; JAX's choice if left out.
    """
    count = _begin_processes(device, processes)
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.leaderboard import check_results, checking, scores

    manifest, hidden = _find_problems(problems, secret)
    out_path = out or Path("runs") / submission.resolve().name
    with ProgressBar() as bar:
        try:
            is_judged = checking.check_submission(
                submission,
                out_path,
                bar,
                manifest=manifest,
                secret=hidden,
                sets=sets,
                resume=resume,
                keep_flights=keep_flights,
                processes=count,
            )
        except KeyboardInterrupt:
            is_judged = False
    if not is_judged:
        print(f"interrupted: go on with --resume --out {out_path}", file=sys.stderr)
        sys.exit(130)
    print(scores.format_scores(check_results.read_result(out_path)))
    print(out_path)


def build(
    results: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    out: Path = Path("runs/board"),
    baselines: bool = True,
) -> None:
    """Build the board: a static page of the scores of submissions.

    Args:
        results: Results folders of angler leaderboard check, or their result.json.
        out: Folder of the page; replaced if it is a board.
        baselines: Show the package's own planners too.
    """
    from angler_mjx.leaderboard import board

    print(board.build_board(results, out, baselines=baselines))


def make_baselines(
    out: Path = Path("runs/baselines"),
    only: Sets = (),
    sets: Sets = (),
    store: Path | None = None,
    workers: int | None = None,
    processes: int | None = None,
    keep_flights: bool = False,
    device: Device | None = None,
) -> None:
    """Plan, check and store the package's planners and policies; a repeated call goes on.

    Each baseline is made in parts, one for each team size, or at once by several processes. Ctrl-C
    keeps what is planned and flown.

    Args:
        out: Folder of submissions and checks, new or of an earlier call.
        only: Baseline, such as priority, mppi or RRTConnect; all if left out.
        sets: A set such as reef-still-known-04, or parts of names such as reef-04; all that the
            baseline can plan if left out.
        store: Folder of the results, one file each; that which the board reads if left out.
        workers: Number of planning processes, for planners on the host; one for each processor if
            left out.
        processes: Processes that compile and plan or fly side by side on the device; on a GPU half
            of the processors, at most 8, else 1, if left out.
        keep_flights: Keep the trajectories, for angler leaderboard films.
        device: Device to plan and fly on; JAX's choice if left out.
    """
    count = _begin_processes(device, processes)
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.leaderboard import baselines, board

    planning = require_positive("workers", workers)
    chosen = baselines.select_baselines(only)
    with ProgressBar() as bar:
        try:
            for path in baselines.make_baselines(
                chosen,
                out,
                store or board.baselines_folder(),
                bar,
                sets=sets,
                workers=planning,
                processes=count,
                keep_flights=keep_flights,
            ):
                bar.report(str(path))
        except KeyboardInterrupt:
            print("interrupted: the same command goes on", file=sys.stderr)
            sys.exit(130)


def film(
    results: Annotated[tuple[Path, ...], tyro.conf.Positional],
    out: Path = Path("runs/films"),
) -> None:
    """Film the best and the worst flight of each check whose flights were kept.

    The best is the shortest solved problem of the largest team, by time over the straight line's;
    the worst is the failed problem with the fewest arrivals, else the longest solved one.

    Args:
        results: Results folders of angler leaderboard check --keep-flights.
        out: Folder of the films.
    """
    from angler_mjx.cli.shared.progress import ProgressBar
    from angler_mjx.leaderboard import films

    with ProgressBar() as bar:
        for result in results:
            for path in films.film_result(result, out, bar):
                bar.report(str(path))


def _begin_processes(device: Device | None, wanted: int | None) -> int:
    """Choose a device whose memory several processes take, and return their number."""
    from angler_mjx.cli.shared.inputs import require_positive
    from angler_mjx.runs import device_processes

    device_processes.disable_preallocation()  # to choose a GPU starts it
    choose_device(device)
    keep_all_programs()
    return require_positive("processes", wanted) or device_processes.default_count()


def _find_problems(problems: Path | None, secret: Path | None) -> "tuple[ProblemManifest, bytes]":
    """Return the manifest of the problems, and the secret of their seeds."""
    from angler_mjx.leaderboard import problem_files, problem_sets

    if (problems is None) != (secret is None):
        raise ConfigError("--problems and --secret: hidden problems need both; leave out both")
    if problems is None:
        return problem_files.public_manifest(), problem_sets.PUBLIC
    manifest, hidden = (
        problem_files.read_manifest(problems / problem_files.MANIFEST),
        _read_secret(secret),
    )
    if manifest.secret != problem_sets.digest_secret(hidden):
        raise ConfigError(f"--secret {secret}: is not that of the problems in {problems}")
    return manifest, hidden


def _read_secret(path: Path | None) -> bytes:
    """Return the bytes of a secret."""
    from angler_mjx.leaderboard.problem_sets import PUBLIC

    if path is None:
        return PUBLIC
    try:
        secret = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"--secret {path}: cannot be read ({error.strerror})") from error
    if len(secret) < 16:
        raise ConfigError(f"--secret {path}: has {len(secret)} bytes; at least 16 random ones")
    return secret
