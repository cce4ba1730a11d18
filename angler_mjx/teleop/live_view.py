"""The Rerun viewer beside the terminal: the world, and the robots as they are driven.

Imported only where Rerun is installed; `require` says so where it is not.
"""

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import jax
import numpy as np

from angler_mjx.errors import UnsupportedError
from angler_mjx.session.batch import Inside
from angler_mjx.session.interface import Observation, Session
from angler_mjx.sim.state import World
from angler_mjx.teleop.pilot import Pilot
from angler_mjx.teleop.status import drives
from angler_mjx.vehicles import library
from angler_mjx.viewing import replay, style
from angler_mjx.viewing.scene import Scene

if TYPE_CHECKING:
    import rerun as rr

ROOT = "scene"

MOVE_S, TRAIL_S = 0.1, 1.0
"""From one pose to the next, and from one trail to the next, in seconds of the scene."""

_TRAIL_POINTS = 600
"""A trail shows the last minute: each update sends it whole."""


def require(out: Path | None) -> None:
    """Refuse a view that could neither be opened nor saved.

    Raises:
        UnsupportedError: Rerun is not installed, or there is neither a display nor a run folder.
    """
    if importlib.util.find_spec("rerun") is None:
        raise UnsupportedError(
            "--rerun: Rerun is not installed; install the extra `view` "
            "(pip install 'angler-mjx[view]'), or leave --rerun out"
        )
    if not replay.has_display() and out is None:
        raise UnsupportedError(
            "--rerun: no display to open the viewer on; give --out RUN as well, and the replay is "
            "saved there at the end, or leave --rerun out"
        )


class Viewable(Session, Protocol):
    """A session whose world can be shown."""

    def inside(self) -> Inside:
        """What lies behind it."""
        ...


class LiveView:
    """Logs a session to a recording as it goes; see `loop.Watcher`."""

    def __init__(
        self,
        recording: "rr.RecordingStream",
        session: Viewable,
        pilot: Pilot,
    ) -> None:
        """Log what does not move.

        Args:
            recording: where to.
            session: that is about to be driven.
            pilot: knows who drives what.
        """
        self._recording, self._robots, self._pilot = recording, session.robots, pilot
        self._world: World = jax.tree.map(lambda leaf: np.asarray(leaf)[0], session.inside().worlds)
        self._steps = 0
        self._move = max(1, round(MOVE_S / session.dt_s))
        # A whole number of moves, so that both fall on the same steps.
        self._redraw = self._move * max(1, round(TRAIL_S / MOVE_S))
        self._trails: list[list[np.ndarray]] = [[] for _ in self._robots]
        self._log_still()

    def after(self, observation: Observation) -> None:
        """Log poses, trails and obstacles where they are due."""
        if self._steps % self._move == 0:
            self._recording.set_time("time", duration=observation.time_s)
            trails_due = self._steps % self._redraw == 0
            self._log_robots(observation, trails=trails_due)
            if trails_due:
                self._log_obstacles(observation)
        self._steps += 1

    def _log_still(self) -> None:
        import rerun as rr

        from angler_mjx.viewing import replay_world as drawing

        recording, path = self._recording, self._world.path
        recording.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        drawing.log_surroundings(recording, self._scene(0.0, None), f"{ROOT}/space")
        for i, robot in enumerate(self._robots):
            color = drawing.bright(style.robot_color(i))
            space = f"{ROOT}/space/{robot.name}"
            goal = rr.Points3D(
                [self._world.environment.goal_m[i]],
                radii=[0.3],
                colors=[color],
                labels=[f"goal {i}"],
            )
            plan = rr.LineStrips3D([path.position_m[i]], colors=[color], radii=[0.02])
            recording.log(f"{space}/goal", goal, static=True)
            recording.log(f"{space}/plan", plan, static=True)
            config = library.load(robot.vehicle)
            drawing.log_vehicle(recording, config, f"{space}/vehicle", color)

    def _log_robots(self, observation: Observation, *, trails: bool) -> None:
        import rerun as rr

        from angler_mjx.viewing import replay_world as drawing

        known = observation.truth or observation.estimate
        for i, robot in enumerate(self._robots):
            p, q = np.asarray(known.p)[i], np.asarray(known.q)[i]
            color = drawing.bright(style.robot_color(i))
            space = f"{ROOT}/space/{robot.name}"
            pose = rr.Transform3D(translation=p, quaternion=q[[1, 2, 3, 0]])
            self._recording.log(f"{space}/vehicle", pose)
            self._trails[i] = [*self._trails[i], p][-_TRAIL_POINTS:]
            if not trails:
                continue
            label = f"{i}: {drives(i, self._pilot, observation.status[i])}"
            self._recording.log(
                f"{space}/vehicle/label",
                rr.Points3D([[0.0, 0.0, 0.45]], labels=[label], colors=[color], radii=[0.08]),
            )
            line = rr.LineStrips3D([np.stack(self._trails[i])], colors=[color], radii=[0.045])
            self._recording.log(f"{space}/trail", line)

    def _log_obstacles(self, observation: Observation) -> None:
        from angler_mjx.viewing import replay_world as drawing

        if observation.obstacles is not None:
            now = self._scene(observation.time_s, observation)
            drawing.log_obstacles(self._recording, now, f"{ROOT}/space/obstacles")

    def _scene(self, time_s: float, observation: Observation | None) -> Scene:
        """The world at one time, as pictures take it."""
        given = self._world.environment.obstacles
        p, q = np.array(given.p0), np.array(given.q0)
        if observation is not None and observation.obstacles is not None:
            there = np.asarray(given.exists)
            p[there], q[there] = observation.obstacles.position_m, observation.obstacles.attitude
        return Scene(
            world=0,
            time_s=np.array([time_s]),
            environment=self._world.environment,
            robots=(),
            obstacle_p_m=p[None],
            obstacle_q=q[None],
        )


def open_viewer(session: Viewable, pilot: Pilot, title: str) -> LiveView:
    """Open the viewer on a session that is about to be driven.

    Args:
        session: that is about to be driven.
        pilot: who drives what.
        title: name of the recording.

    Raises:
        UnsupportedError: the viewer cannot be started.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    recording = rr.RecordingStream("angler_mjx", recording_id=title)
    grid = session.inside().worlds.environment.grid
    low = np.asarray(grid.origin_m)[0]
    high = low + float(np.asarray(grid.cell_m)[0]) * np.array(grid.occupied.shape[1:])
    blueprint = rrb.Blueprint(
        replay.space_view((low, high), f"/{ROOT}"),
        rrb.TimePanel(timeline="time", play_state="following", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )
    replay.spawn(recording, blueprint)
    return LiveView(recording, session, pilot)
