"""Replays in the Rerun viewer: a file of selected worlds of a run, or the viewer on one world."""

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from angler_mjx.errors import UnsupportedError
from angler_mjx.report.plotting import scene
from angler_mjx.report.viewing import viewer_window
from angler_mjx.report.viewing.maps import world_map
from angler_mjx.report.viewing.world_selection import good_world, worst_world
from angler_mjx.runs.storage.atomic_files import replace_file
from angler_mjx.runs.storage.folder import REPLAY, Run

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

__all__ = ["good_world", "show_world", "worst_world", "write_replay"]

SERVER_ADDRESS = "127.0.0.1"
"""Loopback address; without ``--bind`` Rerun's server listens on all interfaces."""

_PLAYBACK_SPEED = 4.0
"""Playback speed, times real time: a crossing takes a quarter of a minute."""


def write_replay(run: Run, worlds: Sequence[int] | None = None, out: Path | None = None) -> Path:
    """Write a replay file; an older one is replaced.

    Args:
        run: run folder.
        worlds: global indices; the worst and one good world if left out.
        out: file to write; ``replay.rrd`` of the run folder if left out.

    Raises:
        UnsupportedError: Rerun is not installed.
        ConfigError: the run stored no trajectories, does not hold a world, or the file name is
            invalid.
        RunError: the file cannot be written.
    """
    chosen = list(dict.fromkeys([worst_world(run), good_world(run)] if worlds is None else worlds))
    rr = _import_rerun(run, chosen[0])
    scenes = [scene.read_scene(run, world) for world in chosen]
    path = run.path / REPLAY if out is None else out
    recording = rr.RecordingStream("angler_mjx", recording_id=_recording_id(run))
    with replace_file(path, flag="--out", force=True) as writing:
        recording.save(writing)
        viewer_window.activate_blueprint(recording, _build_blueprint(scenes))
        _log_scenes(recording, scenes)
        recording.flush()
        recording.disconnect()
    return path


def show_world(run: Run, world: int) -> None:
    """Open the Rerun viewer on one world of a run.

    Args:
        run: run folder.
        world: global index.

    Raises:
        UnsupportedError: Rerun is not installed, or there is no display.
        ConfigError: the run stored no trajectories, or does not hold that world.
    """
    rr = _import_rerun(run, world)
    if not viewer_window.has_display():
        name = f"world_{world}.rrd"
        raise UnsupportedError(
            "no display to open the viewer on; write this world to a file with "
            f"`angler replay {run.path} --world {world} --out {name}`, then open the file on a "
            f"machine with a display (`rerun {name}`), or serve it to browsers of this machine "
            f"alone (`rerun --serve-web --bind {SERVER_ADDRESS} {name}`)"
        )
    scenes = [scene.read_scene(run, world)]
    recording = rr.RecordingStream("angler_mjx", recording_id=_recording_id(run))
    viewer_window.open_viewer(recording, _build_blueprint(scenes))
    _log_scenes(recording, scenes)
    recording.flush()


def _import_rerun(run: Run, world: int) -> ModuleType:
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


def _recording_id(run: Run) -> str:
    return f"{run.path.name} ({run.scenario.name}, seed {run.scenario.seed})"


def _world_root(world: int) -> str:
    return f"world_{world}"


def _log_scenes(recording: "rr.RecordingStream", scenes: Sequence[scene.ReplayScene]) -> None:
    from angler_mjx.report.viewing.replay_world import log_world

    for world_scene in scenes:
        log_world(recording, world_scene, _world_root(world_scene.world))


def _build_blueprint(scenes: Sequence[scene.ReplayScene]) -> "rrb.Blueprint":
    """Build one tab per world; the run plays at once and repeats."""
    import rerun.blueprint as rrb

    tabs = [_build_tab(world_scene) for world_scene in scenes]
    panel = rrb.TimePanel(
        timeline="time",
        playback_speed=_PLAYBACK_SPEED,
        play_state="playing",
        loop_mode="all",
        state="collapsed",
    )
    return viewer_window.build_blueprint(rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0], panel)


def _build_tab(world_scene: scene.ReplayScene) -> "rrb.Horizontal":
    """Build the world in space, with the fleet's table, distances or progress, and events."""
    import rerun.blueprint as rrb

    from angler_mjx.report.viewing.entities import MAX_NAMED

    root = f"/{_world_root(world_scene.world)}"
    eye = viewer_window.eye_above(world_scene.bounds_m)
    space = viewer_window.space_view([f"{root}/space/**"], root, "World", eye)
    time_range = rrb.TimeRange(
        start=rrb.TimeRangeBoundary.absolute(seconds=0.0),
        end=rrb.TimeRangeBoundary.absolute(seconds=float(world_scene.time_s[-1])),
    )
    columns = rrb.TextLogColumns(timeline_columns=["time"], text_log_columns=["LogLevel", "Body"])
    plotted, name = "distance_to_goal_m", "Distance to goal, m"
    if world_scene.task is not None:
        plotted, name = "progress", "Progress, %"
    named = world_scene.task is None and len(world_scene.robots) <= MAX_NAMED
    side = rrb.Vertical(
        rrb.TextDocumentView(origin=f"{root}/fleet", name="Fleet"),
        rrb.TimeSeriesView(
            origin=f"{root}/{plotted}",
            name=name,
            axis_x=rrb.TimeAxis(view_range=time_range),
            axis_y=None if world_scene.task is None else rrb.ScalarAxis(range=(0.0, 102.0)),
            plot_legend=rrb.PlotLegend(visible=named),
        ),
        rrb.TextLogView(origin=f"{root}/events", name="Events", columns=columns),
        row_shares=[3, 3, 2],
    )
    arrived = world_map.describe_outcomes(world_scene).split(",")[0]
    return rrb.Horizontal(
        space, side, column_shares=[3, 1.4], name=f"World {world_scene.world}: {arrived}"
    )
