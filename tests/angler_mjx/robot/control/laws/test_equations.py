"""Every law against its equations, for random vehicles, gains, memories, states and commands."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    Estimate,
    PoseTarget,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import (
    aitsm,
    computed_torque,
    ismc,
    los,
    pid_pose,
    pid_velocity,
    pose,
    tracking,
    velocity,
)
from angler_mjx.robot.control.laws.ardusub import law as ardusub
from angler_mjx.robot.control.laws.ardusub.pid import PidCarry
from angler_mjx.robot.vehicles import library, params

from ....compiling import quickly
from . import equations, firmware
from .equations import DT, RHO, G

N, POINTS = 96, 5
LIVELY = np.where(np.arange(N) % 4 < 2, 1.0, 0.03)
"""Half of the cases are nearly at rest and level, so that little is cut."""
LAWS = {
    "pid_pose": (pid_pose, pid_pose.PidPoseGains),
    "velocity": (velocity, velocity.VelocityGains),
    "pid_velocity": (pid_velocity, pid_velocity.PidVelocityGains),
    "computed_torque": (computed_torque, computed_torque.ComputedTorqueGains),
    "tracking": (tracking, tracking.TrackingGains),
    "ismc": (ismc, ismc.IsmcGains),
    "aitsm": (aitsm, aitsm.AitsmGains),
    "los": (los, los.LosGains),
    "ardusub": (ardusub, ardusub.ArduSubGains),
}
COMMANDS = {
    "pid_pose": "pose",
    "computed_torque": "target",
    "tracking": "target",
    "los": "path",
    "ardusub": "pose",
}
MORE = {
    "pid_velocity": ("realised",),
    "computed_torque": ("flow",),
    "tracking": ("flow", "realised"),
    "ismc": ("flow",),
    "aitsm": ("flow",),
}


def scattered(rng, gains):
    """Gains of half to one and a half of the defaults; where these are 0, up to 0.3."""
    defaults = dataclasses.asdict(gains())
    made = {
        name: rng.uniform(0.5, 1.5, N) * value if value else rng.uniform(0.0, 0.3, N)
        for name, value in defaults.items()
    }
    if "ANGLE_MAX" in made:
        made["SERVO_TRIM"] = rng.uniform(1400.0, 1600.0, N)
        made["MOT_PWM_MIN"], made["MOT_PWM_MAX"] = np.full(N, 1120.0), np.full(N, 1910.0)
        # Half of these are looked at between 40 and 720 degrees/s^2, 10 and 120 for yaw.
        made["ATC_ACCEL_Y_MAX"] = 10 ** rng.uniform(3.0, 4.7, N)
        made["ATC_ACCEL_R_MAX"], made["ATC_ACCEL_P_MAX"] = 10 ** rng.uniform(3.5, 5.5, (2, N))
    return gains(**made)


def vehicles(rng):
    """Heavies and six-thruster frames with full matrices; a third has no sway."""
    kinds = [("bluerov2_heavy", "wu2018"), ("bluerov2", "blue_gazebo")]
    both = params.stack_vehicles(
        [params.build_vehicle(library.load_vehicle(name), one, 14.8) for name, one in kinds]
    )
    kind = np.arange(N) % 2
    picked = jax.tree.map(lambda leaf: np.asarray(leaf, float)[kind], both)

    def symmetric(n, size):
        some = rng.uniform(-1.0, 1.0, (N, n, n)) * size
        return some @ some.swapaxes(1, 2)

    speed = rng.uniform(0.6, 1.5, (N, 3))
    speed[::3, 1] = 0.0
    return kind == 1, dataclasses.replace(
        picked,
        mass_kg=rng.uniform(8.0, 14.0, N),
        inertia_kgm2=symmetric(3, 0.4),
        M_A=symmetric(6, 1.5),
        D_l=rng.uniform(0.0, 10.0, (N, 6)),
        D_q=rng.uniform(0.0, 20.0, (N, 6)),
        volume_m3=rng.uniform(0.008, 0.014, N),
        p_cb_m=rng.uniform(-0.05, 0.05, (N, 3)),
        terminal_speed_mps=speed,
        steered=True,
    )


def paths(rng, at):
    """Way-points, the last up to twice again, and a segment of it that the robot is near."""
    leg = rng.uniform(-1.0, 1.0, (N, POINTS, 3)) * 2.0
    point, real = np.cumsum(leg, axis=1), rng.integers(3, POINTS + 1, N)
    rows = np.minimum(np.arange(POINTS), real[:, None] - 1)
    point = np.take_along_axis(point, rows[..., None], axis=1)
    lengths = np.linalg.norm(np.diff(point, axis=1), axis=-1)
    time = np.cumsum(lengths / rng.uniform(0.03, 1.2, lengths.shape), axis=1)
    segment = rng.integers(0, real - 1)
    share = rng.uniform(-0.1, 1.1, (N, 1))
    begin, end = (point[np.arange(N), segment + k] for k in (0, 1))
    near = begin + share * (end - begin) + rng.normal(size=(N, 3)) * rng.uniform(0.01, 0.5, (N, 1))
    path = Trajectory(
        time_s=np.pad(time, ((0, 0), (1, 0))),
        position_m=point - near[:, None] + at.p[:, None],
        found=np.ones(N, bool),
    )
    memory = los.LosCarry(
        segment=segment.astype(np.int32),
        integral=rng.normal(size=(N, 3)) * 2.0,
        yaw_rad=rng.uniform(-np.pi, np.pi, N),
    )
    return path, memory


def memories(rng, path_memory):
    """What the laws remember, at random."""

    def some(*shape, size=1.0):
        return rng.normal(size=(N, *shape)) * size * LIVELY.reshape(-1, *[1] * len(shape))

    def pids(*shape, size):
        names = ("target", "error", "derivative", "integral")
        return PidCarry(**{name: some(*shape, size=size) for name in names})

    return {
        "pid_pose": pid_pose.PidPoseCarry(integral_mps=some(3, size=0.3)),
        "velocity": velocity.VelocityCarry(integral=some(6, size=2.0)),
        "pid_velocity": pid_velocity.PidVelocityCarry(
            integral=some(6, size=2.0),
            nu=some(6, size=0.4),
            acceleration=some(6),
            demand=some(6, size=20.0),
        ),
        "computed_torque": computed_torque.ComputedTorqueCarry(integral=some(6, size=3.0)),
        "tracking": tracking.TrackingCarry(integral=some(6, size=3.0), demand=some(6, size=20.0)),
        "ismc": ismc.IsmcCarry(integral=some(6), fresh=rng.random(N) < 0.2),
        "aitsm": aitsm.AitsmCarry(z=some(6), k_1=rng.uniform(0.0, 5.0, (N, 6))),
        "los": path_memory,
        "ardusub": ardusub.ArduSubCarry(
            yaw_rad=rng.uniform(-np.pi, np.pi, N) * LIVELY,
            yaw_rate_radps=some(size=0.4),
            velocity_mps=some(3, size=0.4),
            velocity_error_z=some(size=0.2),
            plane=pids(2, size=0.3),
            depth=pids(size=30.0),
            rate=pids(3, size=0.2),
            limited=rng.random(N) < 0.3,
        ),
    }


def draw():
    """Arguments of all laws, [N] leading; and which vehicles have the frame of six."""
    rng = np.random.default_rng(11)
    q = rng.normal(size=(N, 4)) * 0.3 * LIVELY[:, None] + [1.0, 0.0, 0.0, 0.0]
    q[1::4] = [0.0, 0.1, -0.1, 1.0] + rng.normal(size=(len(q[1::4]), 4)) * 0.2
    at = Estimate(
        p=rng.normal(size=(N, 3)) * 5.0,
        q=q / np.linalg.norm(q, axis=1, keepdims=True),
        nu=rng.normal(size=(N, 6)) * 0.4 * LIVELY[:, None],
    )
    # From centimetres to metres: within and beyond what speeds allow.
    off = rng.normal(size=(N, 3)) * np.geomspace(0.02, 6.0, N)[:, None]
    target = TrackingTarget(
        position_m=at.p + off,
        velocity_mps=rng.normal(size=(N, 3)) * 0.2,
        acceleration_mps2=rng.normal(size=(N, 3)) * 0.2,
        yaw_rad=rng.uniform(-np.pi, np.pi, N) * LIVELY,
        yaw_rate_radps=rng.normal(size=N) * 0.3,
        yaw_acceleration_radps2=rng.normal(size=N) * 0.2,
    )
    path, path_memory = paths(rng, at)
    six, vehicle = vehicles(rng)
    slip = rng.normal(size=(N, 6))
    given = {
        "vehicle": vehicle,
        "at": at,
        "target": target,
        "pose": PoseTarget(
            position_m=target.position_m,
            velocity_mps=target.velocity_mps,
            yaw_rad=target.yaw_rad,
        ),
        "twist": BodyTwist(nu=at.nu + slip * np.geomspace(0.02, 1.0, N)[:, None]),
        "path": path,
        "flow": rng.normal(size=(N, 3)) * 0.3,
        "realised": BodyWrench(tau=rng.normal(size=(N, 6)) * 20.0),
        "cruise": rng.uniform(0.2, 1.0, N),
        "memory": memories(rng, path_memory),
        "gains": {name: scattered(rng, kind) for name, (_, kind) in LAWS.items()}
        | {"pose": scattered(rng, pose.PoseGains)},
    }
    return six, given


def all_laws(given):
    """One step of every law."""
    found = {}
    for name, (law, _) in LAWS.items():
        more = {key: given[key] for key in MORE.get(name, ())}
        start = given["gains"][name], given["vehicle"], given["memory"][name], given["at"]
        command = given[COMMANDS.get(name, "twist")]
        found[name] = law.step(*start, command, DT, RHO, G, **more)
    twist = pose.step(
        given["gains"]["pose"], given["vehicle"], given["cruise"], given["at"], given["pose"]
    )
    return found | {"pose": ((), twist)}


@pytest.fixture(scope="module")
def stepped():
    """What was given, what the laws made of it, in float64; and the same case by case.

    Cases begin with whether the vehicle has the frame of six.
    """
    six, given = draw()
    with jax.enable_x64(True):
        there = jax.tree.map(jnp.asarray, given)
        found = jax.device_get(quickly(jax.vmap(all_laws))(there))
    cases = [jax.tree.map(lambda leaf, i=i: leaf[i], (given, found)) for i in range(N)]
    return given, found, [(kind, *case) for kind, case in zip(six, cases, strict=True)]


def expected(name, six, one):
    """The law's equations for one case."""
    g, v, at = one["gains"][name], one["vehicle"], one["at"]
    if name == "pose":
        return {}, equations.pose(g, v, one["cruise"], at, one["pose"])
    carry = one["memory"][name]
    command = one[COMMANDS.get(name, "twist")]
    if name == "ardusub":
        return firmware.step(g, six, carry, at, command)
    if isinstance(command, BodyTwist):
        command = command.nu
    more = {"flow": one["flow"], "realised": one["realised"].tau}
    more = {key: more[key] for key in MORE.get(name, ())}
    return getattr(equations, name)(g, v, carry, at, command, **more)


def same(found, wanted, where):
    """A dataclass or array equals a dict or array, to the rounding of float64."""
    if isinstance(wanted, dict):
        for key, value in wanted.items():
            same(getattr(found, key), value, f"{where}.{key}")
        return
    # Roots are rounded off below 1e-12: a nanometre of what is a millimetre here.
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-7, err_msg=where)


@pytest.mark.parametrize("name", [*LAWS, "pose"])
def test_a_step_is_what_the_equations_say(stepped, name):
    for i, (six, one, found) in enumerate(stepped[2]):
        carry, out = found[name]
        memory, command = expected(name, six, one)
        (leaf,) = jax.tree.leaves(out)
        if "yaw_rad" in memory:
            off = equations.wrapped(carry.yaw_rad - memory.pop("yaw_rad"))
            assert abs(off) < 1e-7, f"case {i}"
        same(carry, memory, f"case {i}")
        same(leaf, command, f"case {i}, output")


def test_bounds_are_met_in_some_cases_and_not_in_others(stepped):
    given, found, _ = stepped
    goes_on = found["los"][0].segment != given["memory"]["los"].segment
    cut = found["ardusub"][0].limited
    fast = np.linalg.norm(given["target"].position_m - given["at"].p, axis=1) > 1.5
    limit = given["gains"]["velocity"].integral_limit_mps2
    held = np.abs(found["velocity"][0].integral) == limit[:, None]
    for often in (goes_on, cut, fast, held):
        assert 0.05 < np.mean(often) < 0.95
