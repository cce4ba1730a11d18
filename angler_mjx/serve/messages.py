"""Messages of a session after each step, as tables of their fields."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import jax
import numpy as np

from angler_mjx.report.interop import ros_messages as ros
from angler_mjx.report.interop import world_markers
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS
from angler_mjx.robot.control.plans import of_robot, trace_path
from angler_mjx.runs.session.batch_session import SessionInternals
from angler_mjx.runs.session.interface import Floats, RobotInfo
from angler_mjx.runs.session.state_view import rotate_vectors
from angler_mjx.serve.instruments import FleetInstruments, FleetReading
from angler_mjx.serve.scene_view import RobotFacts, SceneView
from angler_mjx.serve.topics import MAP_FRAME
from angler_mjx.sim.state import Outcome

type Build = Callable[[], ros.Message | None]
"""Builder of a message; None where there is none at this time."""

SURFACE_PRESSURE_PA = 101_325.0
UNKNOWN = float("nan")
_OK, _WARN, _ERROR = b"\x00", b"\x01", b"\x02"
_LIPO, _DISCHARGING = 3, 2
_DVL_MIN_M, _DVL_MAX_M = 0.05, 50.0


def measure_joints(
    info: RobotInfo, state: Estimate, robot: int
) -> tuple[list[str], Floats, Floats]:
    """Return names, positions and speeds of a robot's joints: of the vehicle, then of the arm.

    Args:
        info: the robot.
        state: motion of the fleet.
        robot: its index.
    """
    p, q, nu = (np.asarray(part[robot], float) for part in (state.p, state.q, state.nu))
    w, x, y, z = q
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    velocity, turn = rotate_vectors(q, nu[:3]), rotate_vectors(q, nu[3:])
    position, speed = [*p, yaw], [*velocity, turn[2]]
    if info.joints and state.joints is not None:
        position += np.asarray(state.joints.position[robot])[: len(info.joints)].tolist()
        speed += np.asarray(state.joints.velocity[robot])[: len(info.joints)].tolist()
    return [*VEHICLE_JOINTS, *info.joints], np.array(position), np.array(speed)


class SceneMessages:
    """Builder of the messages of one session."""

    def __init__(
        self,
        robots: Sequence[RobotInfo],
        facts: Sequence[RobotFacts],
        *,
        dt_s: float,
        density_kgpm3: float,
        gravity_mps2: float,
        has_instruments: bool = True,
    ) -> None:
        """Compile the instruments.

        Args:
            robots: robots of the session.
            facts: facts of each robot.
            dt_s: control period, s.
            density_kgpm3: of the water.
            gravity_mps2: m/s^2.
            has_instruments: whether instruments, batteries and currents are simulated.
        """
        self._has_instruments = has_instruments
        self._robots, self._facts, self._dt_s = robots, facts, dt_s
        self._pascal_per_m = density_kgpm3 * gravity_mps2
        self._instruments = FleetInstruments(
            [fact.sensors for fact in facts], dt_s=dt_s, gravity_mps2=gravity_mps2
        )
        self._energy_j: Floats = np.zeros(len(robots))

    def reset(self, internals: SessionInternals, seed: int, view: SceneView) -> None:
        """Begin with a scene at its reset."""
        if self._has_instruments:
            self._instruments.reset(internals.worlds, seed, _truth(view))
        self._energy_j = view.energy_j
        # An index on the device is a program each.
        on_host = jax.device_get((internals.worlds.environment, internals.worlds.path))
        environment, path = jax.tree.map(lambda leaf: leaf[0], on_host)
        self._environment, self._path = environment, path

    def build_static(self) -> Iterator[tuple[str, Build]]:
        """Return the names and builders of the messages that are sent once after a reset."""
        yield (
            "/scenery",
            lambda: {
                "markers": world_markers.build_scenery(self._environment, MAP_FRAME, has_goals=True)
            },
        )
        for i, info in enumerate(self._robots):
            yield f"/{info.name}/goal", partial(self._goal, i)
            yield f"/{info.name}/plan", partial(self._plan, i)

    def build_step(
        self, view: SceneView, notes: Sequence[dict[str, str]]
    ) -> Iterator[tuple[str, Build]]:
        """Return the names and builders of the messages of a step, the most urgent first.

        Call once in each step, and iterate to the end: the instruments have memory.

        Args:
            view: scene after the step.
            notes: remarks on each robot, for the diagnostics.
        """
        time_s = view.observation.time_s
        spent_j, self._energy_j = view.energy_j - self._energy_j, view.energy_j
        yield "/clock", lambda: {"clock": ros.make_stamp(time_s)}
        for i, info in enumerate(self._robots):
            yield f"/{info.name}/odometry", partial(self._odometry, view, i, estimated=False)
        readings = self._instruments.read(_truth(view)) if self._has_instruments else None
        if readings is not None:
            for i, info in enumerate(self._robots):
                yield f"/{info.name}/imu/data", partial(self._imu, view, readings, i)
        yield "/tf", lambda: self._frames(view)
        for i, info in enumerate(self._robots):
            root = f"/{info.name}"
            yield (
                f"{root}/local_position/odom",
                partial(self._odometry, view, i, estimated=True),
            )
            if readings is not None:
                yield f"{root}/imu/static_pressure", partial(self._pressure, view, readings, i)
                yield f"{root}/dvl/twist", partial(self._dvl, view, readings, i)
                yield f"{root}/dvl/range", partial(self._altitude, view, readings, i)
                yield f"{root}/battery", partial(self._battery, view, float(spent_j[i]), i)
                yield f"{root}/current", partial(self._current, view, i)
            yield f"{root}/joint_states", partial(self._joints, view, i)
            yield f"{root}/thruster_pwm_us", partial(self._signals, view, i)
            yield f"{root}/clearance", partial(self._clearance, view, i)
        yield "/obstacles", lambda: self._obstacles(view)
        yield "/diagnostics", lambda: self._diagnostics(view, notes)

    def _base(self, robot: int) -> str:
        return f"{self._robots[robot].name}/base_link"

    def _plan(self, robot: int) -> ros.Message:
        return ros.make_path(MAP_FRAME, *trace_path(of_robot(self._path, robot)))

    def _goal(self, robot: int) -> ros.Message:
        goal = np.asarray(self._environment.goal_m[robot], float)
        return {"header": ros.make_header(0.0, MAP_FRAME), "pose": ros.make_pose(goal)}

    def _odometry(self, view: SceneView, robot: int, *, estimated: bool) -> ros.Message | None:
        seen = view.observation
        state = seen.estimate if estimated else _truth(view)
        p, q, nu = (np.asarray(part[robot]) for part in (state.p, state.q, state.nu))
        if not (np.isfinite(p).all() and np.isfinite(q).all() and np.isfinite(nu).all()):
            return None
        base = self._base(robot)
        message = ros.make_odometry(seen.time_s, MAP_FRAME, base, p, q, nu)
        if estimated and seen.covariance is not None:
            pose, twist = np.zeros((6, 6)), np.zeros((6, 6))
            whole = np.asarray(seen.covariance[robot], float)
            pose[:] = whole[:6, :6]
            inverse = np.asarray(q) * [1.0, -1.0, -1.0, -1.0]
            turned = rotate_vectors(inverse, whole[6:, 6:])  # each row, from W to F
            twist[:3, :3] = rotate_vectors(inverse, turned.T)
            message["pose"] = {"pose": ros.make_pose(p, q), "covariance": pose.ravel().tolist()}
            vectors = {"linear": ros.make_vector(nu[:3]), "angular": ros.make_vector(nu[3:])}
            message["twist"] = {"twist": vectors, "covariance": twist.ravel().tolist()}
        return message

    def _frames(self, view: SceneView) -> ros.Message:
        truth, time_s = _truth(view), view.observation.time_s
        frames = [
            ros.make_transform(
                time_s, MAP_FRAME, self._base(i), np.asarray(truth.p[i]), np.asarray(truth.q[i])
            )
            for i in range(len(self._robots))
            if np.isfinite(truth.p[i]).all() and np.isfinite(truth.q[i]).all()
        ]
        return {"transforms": frames}

    def _imu(self, view: SceneView, readings: FleetReading, robot: int) -> ros.Message | None:
        imu = readings.reading.imu
        if not imu.fresh[robot]:
            return None
        return {
            "header": ros.make_header(view.observation.time_s, self._base(robot)),
            "orientation": ros.make_quaternion(np.asarray(view.observation.estimate.q[robot])),
            "angular_velocity": ros.make_vector(np.asarray(imu.rate_radps[robot])),
            "linear_acceleration": ros.make_vector(np.asarray(imu.specific_force_mps2[robot])),
        }

    def _pressure(self, view: SceneView, readings: FleetReading, robot: int) -> ros.Message | None:
        if not readings.reading.depth_fresh[robot]:
            return None
        depth_m = float(readings.reading.depth_m[robot])
        return {
            "header": ros.make_header(view.observation.time_s, self._base(robot)),
            "fluid_pressure": SURFACE_PRESSURE_PA + self._pascal_per_m * depth_m,
        }

    def _dvl(self, view: SceneView, readings: FleetReading, robot: int) -> ros.Message | None:
        if not readings.reading.dvl_fresh[robot]:
            return None
        velocity = np.asarray(readings.reading.dvl_velocity_mps[robot])
        return {
            "header": ros.make_header(view.observation.time_s, self._base(robot)),
            "twist": {
                "twist": {"linear": ros.make_vector(velocity)},
                "covariance": [0.0] * 36,
            },
        }

    def _altitude(self, view: SceneView, readings: FleetReading, robot: int) -> ros.Message | None:
        if not readings.reading.dvl_fresh[robot]:
            return None
        return {
            "header": ros.make_header(view.observation.time_s, self._base(robot)),
            "min_range": _DVL_MIN_M,
            "max_range": _DVL_MAX_M,
            "range": float(readings.altitude_m[robot]),
        }

    def _battery(self, view: SceneView, spent_j: float, robot: int) -> ros.Message:
        voltage = self._facts[robot].battery_v
        return {
            "header": ros.make_header(view.observation.time_s, self._base(robot)),
            "voltage": voltage,
            "temperature": UNKNOWN,
            "current": -spent_j / (self._dt_s * voltage),
            "charge": UNKNOWN,
            "capacity": UNKNOWN,
            "design_capacity": UNKNOWN,
            "percentage": UNKNOWN,
            "power_supply_status": _DISCHARGING,
            "power_supply_technology": _LIPO,
            "present": True,
        }

    def _joints(self, view: SceneView, robot: int) -> ros.Message:
        names, position, speed = measure_joints(
            self._robots[robot], view.observation.estimate, robot
        )
        return ros.make_joint_state(view.observation.time_s, names, position, speed)

    def _signals(self, view: SceneView, robot: int) -> ros.Message:
        count = len(self._robots[robot].thrusters)
        signals = np.nan_to_num(np.asarray(view.observation.pwm.pwm_us[robot]))[:count]
        return ros.thruster_pwm(np.rint(signals).astype(np.uint16))

    def _clearance(self, view: SceneView, robot: int) -> ros.Message | None:
        clearance = view.observation.clearance_m
        if clearance is None:
            return None
        return {
            "header": ros.make_header(view.observation.time_s, self._base(robot)),
            "max_range": float(self._robots[robot].radius_m),
            "range": float(clearance[robot]),
        }

    def _current(self, view: SceneView, robot: int) -> ros.Message | None:
        if view.current_mps is None or not np.isfinite(view.current_mps[robot]).all():
            return None
        time_s = max(0.0, view.observation.time_s - self._dt_s)
        vector = ros.make_vector(np.asarray(view.current_mps[robot], float))
        return {"header": ros.make_header(time_s, MAP_FRAME), "vector": vector}

    def _obstacles(self, view: SceneView) -> ros.Message | None:
        obstacles = view.observation.obstacles
        if obstacles is None:
            return None
        rows = self._environment.obstacles
        count = len(np.asarray(rows.kind))
        p, q = np.full((count, 3), np.nan), np.full((count, 4), np.nan)
        exists = np.flatnonzero(np.asarray(rows.exists))
        p[exists], q[exists] = obstacles.position_m, obstacles.attitude
        markers = world_markers.build_moving(rows, MAP_FRAME, view.observation.time_s, p, q)
        return {"markers": markers} if markers else None

    def _diagnostics(self, view: SceneView, notes: Sequence[dict[str, str]]) -> ros.Message:
        statuses = []
        for info, status, note in zip(self._robots, view.observation.status, notes, strict=True):
            is_running = status.outcome is Outcome.RUNNING
            level = _ERROR if not is_running else _WARN if status.refused else _OK
            if status.outcome is Outcome.REACHED:
                level = _OK
            values = {
                "outcome": status.outcome.name.lower(),
                "command": status.command,
                "note": status.note,
                "refused": status.refused,
                **note,
            }
            statuses.append(
                {
                    "level": level[0],
                    "name": info.name,
                    "message": status.refused or status.outcome.name.lower(),
                    "hardware_id": info.vehicle,
                    "values": [{"key": key, "value": value} for key, value in values.items()],
                }
            )
        return {
            "header": ros.make_header(view.observation.time_s, ""),
            "status": statuses,
        }


def _truth(view: SceneView) -> Estimate:
    """Return the true motion; the estimate where it is not available."""
    observation = view.observation
    return observation.estimate if observation.truth is None else observation.truth
