"""Making of the gallery: runs, films and page in one folder, each made only if it is not there.

The folder holds ``runs/``, ``scenarios/``, ``NAME.mp4`` and ``NAME.png`` of each film,
``gallery.json`` with what each was made of, and ``index.html``. A repeated call resumes runs and
keeps files whose checksum and origin are the same.
"""

import json
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TypedDict

from angler_mjx import __version__
from angler_mjx.errors import ConfigError
from angler_mjx.progress import Progress
from angler_mjx.report.plotting import scene as worlds
from angler_mjx.report.video import recording, render_pool
from angler_mjx.report.video.encoder import require_encoder
from angler_mjx.runs import multi_run
from angler_mjx.runs.processes import OneProcess
from angler_mjx.runs.storage import folder, results_folder
from angler_mjx.runs.storage.atomic_files import wrap_write_errors, write_json, write_text
from angler_mjx.runs.storage.checksums import hash_file
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.gallery.films import RUNS_FOLDER, SCENARIOS_FOLDER, Film
from angler_mjx.studies.gallery.page import Section, format_page

RECORD_FILE, PAGE_FILE = "gallery.json", "index.html"


class FilmRecord(TypedDict):
    """What the files of a film were made of, and their SHA-256."""

    origin: dict[str, object]
    files: dict[str, str]


def make_gallery(films: Sequence[Film], out: Path, progress: Progress) -> bool:
    """Fly scenarios, render one world of each, and write a page; whether all is finished.

    Args:
        films: what to make; their files stand beside those of other films in the folder.
        out: folder, new or of an earlier call.
        progress: of how far it is.

    Returns:
        False after an interruption of a run; the same call goes on.

    Raises:
        ConfigError: the folder holds a run of another scenario under a film's name.
        UnsupportedError: no OpenGL works here, or PyAV is missing; nothing was flown.
        RunError: the disk gave out.
    """
    require_encoder()
    render_pool.require_opengl()
    parts = [(str(film.run), film.load_scenario()) for film in films]
    for name, scenario in parts:
        _require_same_run(out / name, scenario)
    with wrap_write_errors(out):
        (out / RUNS_FOLDER).mkdir(parents=True, exist_ok=True)
        _copy_scenarios(films, out)
    if not multi_run.fly_runs(parts, out, progress, OneProcess(), {}):
        return False
    sections = []
    for number, film in enumerate(films, 1):
        progress.report(f"film {number} of {len(films)}: {film.name}")
        sections.append(_make_film(film, out, progress))
        write_text(out / PAGE_FILE, format_page(sections))
    return True


def choose_world(run: Run) -> int:
    """Return the first of the worlds in which the most robots arrived."""
    rows = run.episodes.select(["world", "outcome"]).to_pylist()
    arrived: Counter[int] = Counter({row["world"]: 0 for row in rows})
    arrived.update(row["world"] for row in rows if row["outcome"] == "reached")
    return min(arrived, key=lambda world: (-arrived[world], world))


def _require_same_run(path: Path, scenario: Scenario) -> None:
    """Refuse a run, begun or whole, that is of another scenario."""
    if multi_run.run_status(path) == "none":
        return
    stored = folder.read_scenario(results_folder.locate_folder(path))
    # The simulator chose these where the scenario does not.
    chosen = {"kernels": stored.kernels, "tile": stored.tile}
    now, before = scenario.model_copy(update=chosen).model_dump(), stored.model_dump()
    differing = [key for key in now if now[key] != before[key]]
    if differing:
        raise ConfigError(
            f"{path}: is a run of another scenario than the film's ({', '.join(differing)}); "
            "delete it, or choose another folder with --out"
        )


def _copy_scenarios(films: Sequence[Film], out: Path) -> None:
    """Copy the scenario files that only the gallery ships, which the page's commands name."""
    for film in films:
        if file := film.scenario_file:
            (out / SCENARIOS_FOLDER).mkdir(exist_ok=True)
            shutil.copyfile(file, out / SCENARIOS_FOLDER / file.name)


def _make_film(film: Film, out: Path, progress: Progress) -> Section:
    """Make the video and the picture of a film, unless they are there; return its section."""
    run = Run(out / film.run)
    world = choose_world(run)
    end_s = float(worlds.read_scene(run, world).time_s[-1])
    poster_s = min(film.poster_s, end_s)
    video, poster = out / f"{film.name}.mp4", out / f"{film.name}.png"
    origin: dict[str, object] = {
        "version": __version__,
        "episodes": hash_file(run.path / folder.EPISODES),
        "world": world,
        "view": asdict(film.view),
        "poster_s": poster_s,
    }
    if _is_made(film, out, origin):
        progress.report(f"{film.name}: nothing changed, kept")
    else:
        recording.write_picture(run, world, poster, at_s=poster_s, view=film.view)
        report = partial(_report_frame, progress)
        progress.describe(film.name)
        recording.write_video(run, world, video, view=film.view, report=report)
        files = {path.name: hash_file(path) for path in (video, poster)}
        record: dict[str, FilmRecord] = _read_record(out)
        record[film.name] = {"origin": json.loads(json.dumps(origin)), "files": files}
        write_json(out / RECORD_FILE, record)
    return Section(
        film=film,
        run=run,
        world=world,
        poster_s=poster_s,
        duration_s=end_s,
        video_bytes=video.stat().st_size,
    )


def _is_made(film: Film, out: Path, origin: dict[str, object]) -> bool:
    """Whether a film's files are there as they were written, and of the same origin."""
    record = _read_record(out).get(film.name)
    if record is None or record["origin"] != json.loads(json.dumps(origin)):
        return False
    return all(
        (out / name).is_file() and hash_file(out / name) == checksum
        for name, checksum in record["files"].items()
    )


def _read_record(out: Path) -> dict[str, FilmRecord]:
    path = out / RECORD_FILE
    return read_table(path) if path.is_file() else {}


def _report_frame(progress: Progress, done: int, total: int) -> None:
    """Pass on the progress of a video."""
    if done == 1:
        progress.start(total, unit="frames")
    progress.advance(1)
