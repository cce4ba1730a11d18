"""Rerun viewer beside the terminal: the world, and the robots as they are driven.

Imported only where Rerun is installed; `require_viewer` raises where it is not.
"""

import importlib.util
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import jax
import numpy as np

from angler_mjx.errors import UnsupportedError
from angler_mjx.report.plotting import style
from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.report.viewing import viewer_window
from angler_mjx.robot.control import plans
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.link_params import LinkParams, build_links
from angler_mjx.runs.session.batch_session import SessionInternals
from angler_mjx.runs.session.interface import Floats, Observation, RobotStatus, Session
from angler_mjx.sim.posture import trace_links
from angler_mjx.sim.state import Outcome, World
from angler_mjx.teleop.pilot import TeleopPilot, heading
from angler_mjx.teleop.status import format_drive_mode
from angler_mjx.world.rock.grid import Grid

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

MOVE_S, TRAIL_S = 0.1, 1.0
"""Intervals between poses, and between pieces of a trail, in seconds of the scene."""
BACK_M, UP_M = 2.0, 0.8
"""Offset of the chase camera from the robot, along its level heading and upright."""

DOWN_RAD = 0.21
"""Pitch of the chase camera.

It is less than that of the line to the robot, so the robot is seen below the middle, and the
scene ahead of it above."""

_ROCK_CHECKS = 14
"""Number of rock checks on the line from the robot to the camera: every 0.15 m."""
_WHITE_RGBA = (255, 255, 255, 255)


def require_viewer(out: Path | None) -> None:
    """Refuse a view that could neither be opened nor saved.

    Raises:
        UnsupportedError: Rerun is not installed, or there is neither a display nor a run folder.
    """
    if importlib.util.find_spec("rerun") is None:
        raise UnsupportedError(
            "--rerun: Rerun is not installed; install the extra `view` "
            "(pip install 'angler-mjx[view]'), or leave --rerun out"
        )
    if not viewer_window.has_display() and out is None:
        raise UnsupportedError(
            "--rerun: no display to open the viewer on; give --out RUN as well, and the replay is "
            "saved there at the end, or leave --rerun out"
        )


class Viewable(Session, Protocol):
    """Session whose world can be shown."""

    def inside(self) -> SessionInternals:
        """Return the internals of the session."""
        ...


class LiveView:
    """Logger of a session to a recording as it goes; see `loop.Watcher`.

    The entities are those of a replay (`angler_mjx.report.viewing.entities`), and ``ROOT/camera``.
    """

    def __init__(
        self, recording: "rr.RecordingStream", session: Viewable, pilot: TeleopPilot, root: str
    ) -> None:
        """Log the static entities.

        Args:
            recording: destination.
            session: that is about to be driven.
            pilot: its robots and their modes are shown.
            root: path of the entities.
        """
        self._recording, self._session, self._pilot = recording, session, pilot
        self._root, self._space, self._robots = root, f"{root}/space", session.robots
        self._world: World = jax.tree.map(lambda leaf: np.asarray(leaf)[0], session.inside().worlds)
        self._steps = 0
        self._pose_period = max(1, round(MOVE_S / session.dt_s))
        # A whole number of moves, so that both fall on the same steps.
        self._trail_period = self._pose_period * max(1, round(TRAIL_S / MOVE_S))
        self._trails: list[list[Floats]] = [[] for _ in self._robots]
        self._labels = ["" for _ in self._robots]
        self._links: list[tuple[int, LinkParams, list[str]]] = []
        self._log_static()

    def after(self, observation: Observation) -> None:
        """Log moved entities, and trails where they are due."""
        if self._steps % self._pose_period == 0:
            self._recording.set_time("time", duration=observation.time_s)
            motion = observation.truth or observation.estimate
            p, q = np.asarray(motion.p), np.asarray(motion.q)
            self._log_robots(p, q)
            self._log_labels(observation.status)
            self._log_water(observation, p)
            for trail, position_m in zip(self._trails, p, strict=True):
                trail.append(position_m)
            if self._steps % self._trail_period == 0:
                self._log_trails()
        self._steps += 1

    def _log_static(self) -> None:
        import rerun as rr

        from angler_mjx.report.viewing import entities

        recording, path = self._recording, self._world.path
        recording.log(self._root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        start = self._scene(0.0, None)
        entities.log_surroundings(recording, start, self._space)
        entities.log_obstacles(recording, start, f"{self._space}/obstacles")
        for i, robot in enumerate(self._robots):
            config, space = library.load_vehicle(robot.vehicle), f"{self._space}/{robot.name}"
            entities.log_robot(
                recording,
                config,
                i,
                space,
                goal_m=np.asarray(self._world.environment.goal_m[i]),
                plan_m=plans.trace_path(plans.of_robot(path, i))[1],
            )
            if (links := build_links(config, None)) is not None:
                color, vehicle = entities.robot_rgba(i), f"{space}/vehicle"
                paths = entities.log_links(recording, config, vehicle, color)
                self._links.append((i, links, list(paths.values())))
        lens = rr.Pinhole(
            fov_y=1.0,
            aspect_ratio=1.2,
            camera_xyz=rr.ViewCoordinates.FLU,
            image_plane_distance=1e-5,  # hides its frame
        )
        recording.log(f"{self._root}/camera", lens, static=True)

    def _log_robots(self, p: Floats, q: Floats) -> None:
        """Log the poses [R, 3] and [R, 4] of the robots, and that of the camera."""
        import rerun as rr

        from angler_mjx.report.viewing import entities

        moved = {}
        driven = self._pilot.selected[0]
        if np.isfinite(p[driven]).all():  # it may have diverged
            grid = self._world.environment.grid
            moved[f"{self._root}/camera"] = camera_pose(p[driven], q[driven], grid)
        for i, robot in enumerate(self._robots):
            moved[f"{self._space}/{robot.name}/vehicle"] = (p[i], q[i])
        for path, (position_m, attitude) in moved.items():
            turn = rr.Quaternion(xyzw=entities.to_xyzw(attitude))
            self._recording.log(path, rr.Transform3D(translation=position_m, quaternion=turn))
        self._log_links()

    def _log_links(self) -> None:
        """Log the poses of the links of arms; at home where the session has no joints."""
        import rerun as rr

        joints = self._session.inside().state.vehicles.joints
        for i, links, paths in self._links:
            position = links.home if joints is None else joints.position[0, i]
            origin, rotation = trace_links(links, np.asarray(position)[None])
            for path, position_m, turn in zip(paths, origin[0], rotation[0], strict=True):
                self._recording.log(path, rr.Transform3D(translation=position_m, mat3x3=turn))

    def _log_labels(self, status: Sequence[RobotStatus]) -> None:
        """Log each robot's mode and outcome, where they change.

        Robots that receive keys are marked, and white until they end.
        """
        import rerun as rr

        from angler_mjx.report.viewing import entities

        for i, robot in enumerate(self._robots):
            driven, outcome = i in self._pilot.selected, status[i].outcome
            label = f"{'> ' * driven}{i}: {format_drive_mode(i, self._pilot, status[i])}"
            color = _WHITE_RGBA if driven else entities.robot_rgba(i)
            if outcome is not Outcome.RUNNING:
                label += f", {style.OUTCOME_TEXT[outcome.name.lower()]}"
                color = entities.ending_color(arrived=outcome is Outcome.REACHED)
            if label == self._labels[i]:
                continue
            self._labels[i] = label
            dot = rr.Points3D.from_fields(
                labels=[label],
                colors=[color],
                radii=[entities.LARGE_DOT if driven else entities.DOT],
            )
            self._recording.log(f"{self._space}/{robot.name}/vehicle/label", dot)

    def _log_water(self, observation: Observation, p: Floats) -> None:
        """Log the current at the robots [R, 3], and the obstacles in it."""
        import rerun as rr

        from angler_mjx.report.viewing import entities

        sample = self._session.inside().sample
        if sample is not None:
            flow = entities.current_arrows(np.asarray(sample.current_mps)[0])
            arrow = rr.Arrows3D.from_fields(origins=p, vectors=flow)
            self._recording.log(f"{self._space}/current", arrow)
        if observation.obstacles is not None:
            scene = self._scene(observation.time_s, observation)
            for name, shape, fields in entities.obstacle_poses(scene):
                archetype = shape.from_fields(**{key: rows[0] for key, rows in fields.items()})
                self._recording.log(f"{self._space}/obstacles/{name}", archetype)

    def _log_trails(self) -> None:
        """Log the path since the last time; the view shows all the pieces."""
        import rerun as rr

        for robot, trail in zip(self._robots, self._trails, strict=True):
            piece = rr.LineStrips3D.from_fields(strips=[np.stack(trail)])
            self._recording.log(f"{self._space}/{robot.name}/trail", piece)
            del trail[:-1]

    def _scene(self, time_s: float, observation: Observation | None) -> ReplayScene:
        """Return the world at one time, in the form of figures."""
        obstacles = self._world.environment.obstacles
        p, q = np.array(obstacles.p0), np.array(obstacles.q0)
        if observation is not None and observation.obstacles is not None:
            exists = np.asarray(obstacles.exists)
            p[exists], q[exists] = observation.obstacles.position_m, observation.obstacles.attitude
        return ReplayScene(
            world=0,
            time_s=np.array([time_s]),
            environment=self._world.environment,
            robots=(),
            obstacle_p_m=p[None],
            obstacle_q=q[None],
        )


def open_viewer(session: Viewable, pilot: TeleopPilot, title: str, world: int) -> LiveView:
    """Open the viewer on a session that is about to be driven.

    Args:
        session: that is about to be driven.
        pilot: its robots and their modes are shown.
        title: name of the recording.
        world: index of the world.

    Raises:
        UnsupportedError: the viewer cannot be started.
    """
    # Else Rerun writes across the screen when its window is closed; read as it is imported.
    os.environ.setdefault("RUST_LOG", "off")
    import rerun as rr

    recording, root = rr.RecordingStream("angler_mjx"), f"world_{world}"
    recording.send_recording_name(title)
    viewer_window.open_viewer(recording, _blueprint(session, f"/{root}"))
    return LiveView(recording, session, pilot, root)


def _blueprint(session: Viewable, root: str) -> "rrb.Blueprint":
    """Build two views side by side: behind the robot that receives keys, and the whole world."""
    import rerun.blueprint as rrb

    grid = session.inside().worlds.environment.grid
    low = np.asarray(grid.origin_m)[0]
    high = low + float(np.asarray(grid.cell_m)[0]) * np.array(grid.occupied.shape[1:])
    trails = [f"{root}/space/{robot.name}/trail" for robot in session.robots]
    space, camera = f"{root}/space/**", f"{root}/camera"
    behind = rrb.EyeControls3D(tracking_entity=camera)
    chased = viewer_window.space_view([space, camera], root, "Driven robot", behind, trails)
    whole = viewer_window.space_view(
        [space], root, "World", viewer_window.eye_above((low, high)), trails
    )
    panel = rrb.TimePanel(timeline="time", play_state="following", state="collapsed")
    return viewer_window.build_blueprint(
        rrb.Horizontal(chased, whole, column_shares=[1.2, 1.0]), panel
    )


def camera_pose(p: np.ndarray, q: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Return the position and attitude of the chase camera: behind and above the robot.

    It follows the robot's heading and stays level while the robot tilts, as the keys do. Where
    rock would hide the robot, the camera comes nearer.

    Args:
        p: [3] of the robot, m in W.
        q: [4] attitude of the robot, F to W.
        grid: cells of the world, as host arrays.

    Returns:
        Position [3], m in W, and quaternion [4] wxyz: x ahead, y to the left, z up.
    """
    psi = heading(q)
    offset_m = np.array([-BACK_M * math.cos(psi), -BACK_M * math.sin(psi), UP_M])
    path_m = p + np.linspace(0.0, 1.0, _ROCK_CHECKS + 1)[1:, None] * offset_m
    blocked = np.flatnonzero(_is_in_rock(path_m, grid))
    n_clear = _ROCK_CHECKS if blocked.size == 0 else int(blocked[0])
    half, down = 0.5 * psi, 0.5 * DOWN_RAD
    attitude = np.array(
        [
            math.cos(half) * math.cos(down),
            -math.sin(half) * math.sin(down),
            math.cos(half) * math.sin(down),
            math.sin(half) * math.cos(down),
        ]
    )
    return p + max(n_clear, 1) / _ROCK_CHECKS * offset_m, attitude


def _is_in_rock(points_m: np.ndarray, grid: Grid) -> np.ndarray:
    """Return whether points [n, 3] lie in an occupied cell; outside the cells none does."""
    occupied = np.asarray(grid.occupied)
    cells = np.floor((points_m - np.asarray(grid.origin_m)) / float(grid.cell_m)).astype(int)
    inside = ((cells >= 0) & (cells < occupied.shape)).all(axis=1)
    x, y, z = np.clip(cells, 0, np.array(occupied.shape) - 1).T
    rock: np.ndarray = inside & occupied[x, y, z].astype(bool)
    return rock
