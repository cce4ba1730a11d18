"""Replays in the Rerun viewer: a file of some worlds of a run, or the viewer opened on one."""

import os
import shutil
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from angler_mjx.errors import RunError, UnsupportedError
from angler_mjx.runs.folder import REPLAY, Run
from angler_mjx.viewing import maps, scene
from angler_mjx.viewing.choose import good_world, worst_world

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

__all__ = ["good_world", "show", "worst_world", "write"]

_PLAYBACK_SPEED = 4.0
"""Seconds of the run in one of the viewer's: a crossing takes a quarter of a minute."""


def write(run: Run, worlds: Sequence[int] | None = None) -> Path:
    """Write ``replay.rrd`` into a run folder; an older one is replaced.

    Args:
        run: run folder.
        worlds: global indices; the worst and one good world if left out.

    Raises:
        UnsupportedError: Rerun is not installed.
        ConfigError: the run stored no trajectories, or does not hold a world.
        RunError: the file cannot be written.
    """
    chosen = list(dict.fromkeys([worst_world(run), good_world(run)] if worlds is None else worlds))
    rr = _rerun(run, chosen[0])
    scenes = [scene.read(run, world) for world in chosen]
    path = run.path / REPLAY
    written = path.with_suffix(".tmp")
    recording = rr.RecordingStream("angler_mjx", recording_id=_name(run))
    try:
        recording.save(written, default_blueprint=_blueprint(scenes))
        _log(recording, scenes)
        recording.flush()
        recording.disconnect()
        written.replace(path)
    except OSError as error:
        written.unlink(missing_ok=True)
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


def show(run: Run, world: int) -> None:
    """Open the Rerun viewer on one world of a run.

    Args:
        run: run folder.
        world: global index.

    Raises:
        UnsupportedError: Rerun is not installed, or there is no display.
        ConfigError: the run stored no trajectories, or does not hold that world.
    """
    rr = _rerun(run, world)
    if not has_display():
        raise UnsupportedError(
            f"no display to open the viewer on; copy {run.path / REPLAY} to a machine with one and "
            f"open it there with `rerun {REPLAY}`, or serve it from here with "
            f"`rerun --serve-web {run.path / REPLAY}`"
        )
    scenes = [scene.read(run, world)]
    recording = rr.RecordingStream("angler_mjx", recording_id=_name(run))
    spawn(recording, _blueprint(scenes))
    _log(recording, scenes)
    recording.flush()


def has_display() -> bool:
    """Whether there is a display to open the viewer on."""
    named = (os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return sys.platform != "linux" or any(named)


def spawn(recording: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
    """Open the viewer on a recording.

    Raises:
        UnsupportedError: it cannot be started.
    """
    import rerun as rr

    # The viewer's command lies beside this Python, which need not be on the PATH.
    scripts = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    try:
        rr.spawn(
            executable_path=shutil.which("rerun", path=scripts),
            recording=recording,
            default_blueprint=blueprint,
        )
    except RuntimeError as error:
        raise UnsupportedError(f"the Rerun viewer cannot be started: {error}") from error


def _rerun(run: Run, world: int) -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise UnsupportedError(
            "no replay was written: Rerun is not installed. Install the extra `view` "
            f"(pip install 'angler-mjx[view]'), then make it from the run folder: "
            f"`angler figures {run.path}` writes {REPLAY}, "
            f"`angler replay {run.path} --world {world}` opens the viewer"
        ) from error
    return rerun


def _name(run: Run) -> str:
    return f"{run.path.name} ({run.scenario.name}, seed {run.scenario.seed})"


def _root(world: int) -> str:
    return f"world_{world}"


def _log(recording: "rr.RecordingStream", scenes: Sequence[scene.Scene]) -> None:
    from angler_mjx.viewing.replay_world import log_world

    for one in scenes:
        log_world(recording, one, _root(one.world))


def _blueprint(scenes: Sequence[scene.Scene]) -> "rrb.Blueprint":
    """One tab a world; the run plays at once and again when it is over."""
    import rerun.blueprint as rrb

    tabs = [_tab(one) for one in scenes]
    return rrb.Blueprint(
        rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0],
        rrb.TimePanel(
            timeline="time",
            playback_speed=_PLAYBACK_SPEED,
            play_state="playing",
            loop_mode="all",
            state="collapsed",
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


def _tab(one: scene.Scene) -> "rrb.Horizontal":
    """The world in space; beside it the fleet's table, distances to goal, and events."""
    import rerun.blueprint as rrb

    root = f"/{_root(one.world)}"
    space = space_view(one.bounds_m, root)
    whole = rrb.TimeRange(
        start=rrb.TimeRangeBoundary.absolute(seconds=0.0),
        end=rrb.TimeRangeBoundary.absolute(seconds=float(one.time_s[-1])),
    )
    columns = rrb.TextLogColumns(timeline_columns=["time"], text_log_columns=["LogLevel", "Body"])
    side = rrb.Vertical(
        rrb.TextDocumentView(origin=f"{root}/fleet", name="Fleet"),
        rrb.TimeSeriesView(
            origin=f"{root}/distance_to_goal_m",
            name="Distance to goal, m",
            axis_x=rrb.TimeAxis(view_range=whole),
        ),
        rrb.TextLogView(origin=f"{root}/events", name="Events", columns=columns),
        row_shares=[3, 3, 2],
    )
    arrived = maps.describe(one).split(",")[0]
    return rrb.Horizontal(space, side, column_shares=[3, 1.4], name=f"World {one.world}: {arrived}")


def space_view(bounds_m: tuple[np.ndarray, np.ndarray], root: str) -> "rrb.Spatial3DView":
    """A view from above of everything under ``root/space``.

    Args:
        bounds_m: lower and upper corner [3] of the world.
        root: path of its entities, with the leading slash.
    """
    import rerun.blueprint as rrb

    low, high = bounds_m
    middle, size = 0.5 * (low + high), float(max(high - low))
    return rrb.Spatial3DView(
        origin=root,
        contents=[f"{root}/space/**"],
        name="World",
        background=[16, 38, 54],
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=middle + size * np.array([0.95, -1.35, 0.75]),
            look_target=middle - size * np.array([0.0, 0.0, 0.08]),
            eye_up=[0.0, 0.0, 1.0],
        ),
    )
