"""`angler replay`: viewer, replay file, picture or video of a recorded world."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from angler_mjx.errors import ConfigError

if TYPE_CHECKING:
    from angler_mjx.report.video.recording import View
    from angler_mjx.runs.storage.folder import Run


def replay(
    run: Annotated[Path, tyro.conf.Positional],
    world: int | None = None,
    out: Path | None = None,
    video: Path | None = None,
    png: Path | None = None,
    camera: Literal["fixed", "above", "follow"] | None = None,
    robot: int | None = None,
    at: float | None = None,
    speed: float | None = None,
    size: tuple[int, int] | None = None,
) -> None:
    """Show a world of a run folder: in the Rerun viewer, or as a replay file, picture or video.

    Pictures and videos are rendered by MuJoCo and need no display. Videos need the extra `video`.

    Args:
        run: Run folder.
        world: Index of the world; the worst one if left out.
        out: Replay file (.rrd) to write instead of opening the viewer; an older one is replaced.
        video: Video file (.mp4) to write; an older one is replaced.
        png: Picture (.png) to write; an older one is replaced.
        camera: Camera of --video and --png: fixed if left out, from above with north up, or behind
            a robot.
        robot: Robot that --camera follow follows; the first that did not arrive if left out.
        at: Time of --png, s; the end of the record if left out.
        speed: Simulated seconds in a second of --video; 4 if left out.
        size: Width and height of pictures, in pixels; 1280 720 if left out.
    """
    from angler_mjx.report.viewing import replay as viewer
    from angler_mjx.runs.storage.folder import Run

    targets = {"--out": out, "--video": video, "--png": png}
    chosen = [flag for flag, path in targets.items() if path is not None]
    if len(chosen) > 1:
        raise ConfigError(f"{' and '.join(chosen)}: choose one of them")
    view = _build_view(chosen, camera, robot, at, speed, size)
    loaded = Run(run)
    world_index = viewer.worst_world(loaded) if world is None else world
    finished = set(loaded.episodes["world"].to_pylist())
    if world_index not in finished:
        raise ConfigError(f"--world {world_index}: {run} holds worlds 0 to {max(finished)}")
    if video is not None:
        _write_video(loaded, world_index, video, view)
    elif png is not None:
        from angler_mjx.report.video import write_picture

        print(write_picture(loaded, world_index, png, at_s=at, view=view))
    elif out is not None:
        print(viewer.write_replay(loaded, [world_index], out))
    else:
        viewer.show_world(loaded, world_index)


def _build_view(
    chosen: list[str],
    camera: Literal["fixed", "above", "follow"] | None,
    robot: int | None,
    at: float | None,
    speed: float | None,
    size: tuple[int, int] | None,
) -> "View":
    """Return how the world is looked at.

    Raises:
        ConfigError: a flag does not belong to what is written, or a value cannot be used.
    """
    from angler_mjx.report.video.recording import View

    rendered = {"--video", "--png"}
    belongs = (
        ("--camera", camera, rendered),
        ("--robot", robot, rendered),
        ("--size", size, rendered),
        ("--at", at, {"--png"}),
        ("--speed", speed, {"--video"}),
    )
    for flag, value, targets in belongs:
        if value is not None and not targets & set(chosen):
            raise ConfigError(f"{flag}: belongs to {' and '.join(sorted(targets))} FILE")
    if robot is not None and camera != "follow":
        raise ConfigError("--robot: choose --camera follow with it")
    default = View()
    return View(
        camera=default.camera if camera is None else camera,
        robot=robot,
        speed=default.speed if speed is None else speed,
        size_px=default.size_px if size is None else size,
    )


def _write_video(run: "Run", world: int, path: Path, view: "View") -> None:
    """Write a video, with a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from angler_mjx.cli.shared.consoles import make_progress_console
    from angler_mjx.report.video import write_video

    columns = ("frames", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=make_progress_console()) as bar:
        task = bar.add_task("frames", total=None)
        written = write_video(
            run,
            world,
            path,
            view=view,
            report=lambda done, total: bar.update(task, completed=done, total=total),
        )
    print(written)
