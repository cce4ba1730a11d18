"""The study that chose the discretisation: five ways to take a step, against DOP853.

All of them step the same equations, those of `angler_mjx.physics`, in float64: four vehicles with
rotor lag, in a uniform current with one vortex, under random thruster commands that change every
0.2 s. What is compared is the greatest distance from the reference at any of these changes.

    python -m angler_experiments.convergence --out docs/validation.md

writes the table between the two marker lines of that file.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from angler_kernels import quaternion, rigid_body, spd_solve, thruster
from angler_kernels.current_field import lamb_oseen_circulation
from angler_mjx.control import allocation
from angler_mjx.errors import ConfigError
from angler_mjx.physics import mjx_engine, step
from angler_mjx.physics.mjx_engine import BodyInertia, MjxEngine
from angler_mjx.physics.step import VehicleState, Water
from angler_mjx.vehicles import library, mjcf, params
from angler_mjx.vehicles.params import VehicleParams
from angler_mjx.world.currents import Current, Uniform, Vortices

type Array = NDArray[np.float64]

VARIANTS = (
    ("bluerov2_heavy", "wu2018"),
    ("bluerov2_heavy", "von_benzon2022"),
    ("bluerov2_heavy", "blue_gazebo"),
    ("bluerov2", "blue_gazebo"),
)
STEPS_MS = (40, 20, 10, 5)
HOLD_S = 0.2
BATTERY_V = 16.0
MARKERS = ("<!-- convergence:begin -->", "<!-- convergence:end -->")


@dataclass(frozen=True, kw_only=True)
class Case:
    """How roughly the vehicles are driven."""

    name: str
    speed_mps: float
    """Amplitude of surge, sway and heave: the force that drag exerts at this speed."""
    moment_nm: tuple[float, float, float]
    """Amplitude of the moments about x, y, z."""
    memory: float
    """Correlation of a command with the one 0.2 s before."""


CASES = (
    Case(name="moderate", speed_mps=0.45, moment_nm=(0.3, 0.3, 1.0), memory=0.95),
    Case(name="violent", speed_mps=1.2, moment_nm=(5.0, 5.0, 6.0), memory=0.0),
)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """The vehicles [n_variant], and the water that they are in."""

    engine: MjxEngine
    body: BodyInertia
    vehicles: VehicleParams
    current: Current


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table."""

    case: str
    vehicle: str
    parameter_set: str
    greatest_speed_mps: float
    greatest_tilt_deg: float
    step_ms: int
    error_cm: dict[str, float]
    """By scheme; NaN where it blew up."""


def set_up() -> Setup:
    """Compile the vehicles and the current in JAX's present float type."""
    configs = [(library.load(vehicle), chosen) for vehicle, chosen in VARIANTS]
    engine, body = mjx_engine.build(
        [mjcf.to_spec(config, chosen, shapes=False).compile() for config, chosen in configs]
    )
    core = jnp.array([1.5])
    vortex = Vortices(
        centre_m=jnp.array([[1.0, 0.5]]),
        circulation_m2ps=lamb_oseen_circulation(jnp.array([0.3]), core),
        core_m=core,
    )
    return Setup(
        engine=engine,
        body=body,
        vehicles=params.stack([params.build(c, chosen, BATTERY_V) for c, chosen in configs]),
        current=(Uniform(velocity_mps=jnp.array([0.15, 0.1, 0.0])), vortex),
    )


def draw_commands(case: Case, vehicles: VehicleParams, n: int, seed: int) -> Array:
    """Thrusts [n_variant, n, n_thruster] N that settle random wrenches, held for 0.2 s each."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(-1.0, 1.0, (n, 6)) * math.sqrt(3.0)
    for k in range(1, n):
        noise[k] = case.memory * noise[k - 1] + math.sqrt(1 - case.memory**2) * noise[k]
    D_l, D_q = np.asarray(vehicles.D_l)[:, :3], np.asarray(vehicles.D_q)[:, :3]
    force = (D_l + D_q * case.speed_mps) * case.speed_mps
    amplitude = np.concatenate([force, np.tile(case.moment_nm, (len(force), 1))], axis=1)
    inverse = np.asarray(allocation.build(vehicles).B_inverse)
    thrust = np.einsum("vti,vi,ki->vkt", inverse, amplitude / 2, noise)
    ends = np.asarray(vehicles.thrust_n)[:, None, [0, -1]]
    clipped: Array = np.clip(thrust, ends[..., :1], ends[..., 1:])
    return clipped


def first_state(n_thruster: int) -> VehicleState:
    """A vehicle at rest in the middle of the water column."""
    return VehicleState(
        p=jnp.array([0.0, 0.0, -30.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.zeros(6),
        force_before=jnp.zeros(6),
        thrust=jnp.zeros(n_thruster),
    )


type Scheme = Callable[..., VehicleState]
"""(engine, body, params, state, thrust_command, current, t, dt, water) -> state, as `step.step`."""


def _accelerate(
    engine: MjxEngine,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    thrust: jax.Array,
    current: Current,
    t: jax.Array,
    water: Water,
) -> jax.Array:
    """nu' [6] under given thrusts."""
    M, force, _ = step.smooth_force(engine, body, vehicle, state, current, t, water)
    total = force + rigid_body.matrix_times(vehicle.B, thrust)
    return spd_solve.solve(M, total[:, None])[:, 0]


def _euler_world(
    engine: MjxEngine,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Semi-implicit Euler on the velocity in the world, as MuJoCo's default integrator."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    a = _accelerate(engine, body, vehicle, state, mean, current, t, water)
    v, omega = state.nu[:3], state.nu[3:]
    v_world = quaternion.rotate(state.q, v + dt * (a[:3] + jnp.cross(omega, v)))
    omega = omega + dt * a[3:]
    q = _unit(quaternion.multiply(state.q, quaternion.exp(dt * omega)))
    nu = jnp.concatenate([quaternion.rotate_inverse(q, v_world), omega])
    return replace(state, p=state.p + dt * v_world, q=q, nu=nu, thrust=thrust)


def _euler_body(
    engine: MjxEngine,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Semi-implicit Euler on the velocity in the body."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    nu = state.nu + dt * _accelerate(engine, body, vehicle, state, mean, current, t, water)
    p = state.p + dt * quaternion.rotate(state.q, nu[:3])
    q = _unit(quaternion.multiply(state.q, quaternion.exp(dt * nu[3:])))
    return replace(state, p=p, q=q, nu=nu, thrust=thrust)


def _explicit(
    engine: MjxEngine,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Ours with the damping left explicit: two-step Adams-Bashforth for all smooth forces."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    M, force, _ = step.smooth_force(engine, body, vehicle, state, current, t, water)
    nu, before = rigid_body.advance_damped_velocity(
        state.nu,
        M,
        jnp.zeros_like(force),
        force,
        state.force_before,
        rigid_body.matrix_times(vehicle.B, mean),
        dt,
    )
    p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    return VehicleState(p=p, q=q, nu=nu, force_before=before, thrust=thrust)


def _heun(
    engine: MjxEngine,
    body: BodyInertia,
    vehicle: VehicleParams,
    state: VehicleState,
    command: jax.Array,
    current: Current,
    t: jax.Array,
    dt: jax.Array,
    water: Water,
) -> VehicleState:
    """Heun's method with ours's pose step: two evaluations of the forces a step."""
    thrust, mean = thruster.rotor_lag(state.thrust, command, vehicle.tau_s, dt)
    a = _accelerate(engine, body, vehicle, state, mean, current, t, water)
    guess = state.nu + dt * a
    p, q = rigid_body.advance_pose(state.p, state.q, state.nu, guess, dt)
    ahead = replace(state, p=p, q=q, nu=guess)
    b = _accelerate(engine, body, vehicle, ahead, mean, current, t + dt, water)
    nu = state.nu + 0.5 * dt * (a + b)
    p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, dt)
    return replace(state, p=p, q=q, nu=nu, thrust=thrust)


def _unit(q: jax.Array) -> jax.Array:
    return q / jnp.sqrt(jnp.sum(q * q))


SCHEMES: dict[str, Scheme] = {
    "Euler, world velocity": _euler_world,
    "Euler, body velocity": _euler_body,
    "explicit AB2": _explicit,
    "ours": step.step,
    "Heun (two evaluations)": _heun,
}


def simulate(setup: Setup, scheme: Scheme, commands: Array, step_ms: int) -> Array:
    """Positions [n_variant, n_command, 3] after each command."""
    steps = round(HOLD_S * 1e3 / step_ms)
    dt = HOLD_S / steps

    def one(body: BodyInertia, vehicle: VehicleParams, commands: jax.Array) -> jax.Array:
        state = step.start_multistep(
            setup.engine,
            body,
            vehicle,
            first_state(commands.shape[-1]),
            setup.current,
            jnp.zeros(()),
            Water(),
        )

        def hold(state: VehicleState, command: jax.Array) -> tuple[VehicleState, jax.Array]:
            def once(state: VehicleState, _: None) -> tuple[VehicleState, None]:
                # The current is steady: any time will do.
                state = scheme(
                    setup.engine,
                    body,
                    vehicle,
                    state,
                    command,
                    setup.current,
                    jnp.zeros(()),
                    dt,
                    Water(),
                )
                return state, None

            state, _ = jax.lax.scan(once, state, length=steps)
            return state, state.p

        return jax.lax.scan(hold, state, commands)[1]

    return np.asarray(jax.jit(jax.vmap(one))(setup.body, setup.vehicles, jnp.asarray(commands)))


@partial(jax.jit, static_argnames="n_thruster")
def _rate(
    engine: MjxEngine,
    body: BodyInertia,
    vehicle: VehicleParams,
    current: Current,
    y: jax.Array,
    command: jax.Array,
    n_thruster: int,
) -> jax.Array:
    """d/dt of [p, q, nu, thrusts]."""
    state = replace(first_state(n_thruster), p=y[:3], q=y[3:7], nu=y[7:13], thrust=y[13:])
    a = _accelerate(engine, body, vehicle, state, state.thrust, current, jnp.zeros(()), Water())
    spin = jnp.concatenate([jnp.zeros(1), state.nu[3:]])
    return jnp.concatenate(
        [
            quaternion.rotate(state.q, state.nu[:3]),
            0.5 * quaternion.multiply(state.q, spin),
            a,
            (command - state.thrust) / vehicle.tau_s,
        ]
    )


def reference(setup: Setup, index: int, commands: Array) -> Array:
    """States [n_command, 13 + n_thruster] of one variant by DOP853, after each command."""
    body, vehicle = (
        jax.tree.map(lambda leaf: leaf[index], tree) for tree in (setup.body, setup.vehicles)
    )
    n = commands.shape[-1]
    start = first_state(n)
    y = np.concatenate([start.p, start.q, start.nu, start.thrust])
    states = []
    for command in commands:

        def rate(_: float, y: Array, command: Array = command) -> Array:
            return np.asarray(
                _rate(setup.engine, body, vehicle, setup.current, y, command, n_thruster=n)
            )

        solved: Any = solve_ivp(rate, (0, HOLD_S), y, "DOP853", rtol=1e-10, atol=1e-12)
        y = solved.y[:, -1]
        y[3:7] /= np.linalg.norm(y[3:7])
        states.append(y)
    return np.array(states)


def study(
    seconds: float = 60.0, cases: Sequence[Case] = CASES, steps_ms: Sequence[int] = STEPS_MS
) -> list[Row]:
    """Run all schemes against the reference, in float64.

    Args:
        seconds: length of each run.
        cases: how roughly to drive.
        steps_ms: divisors of 200.
    """
    with jax.enable_x64(True):
        setup = set_up()
        return [
            row
            for seed, case in enumerate(cases)
            for row in _study_case(setup, case, round(seconds / HOLD_S), seed, steps_ms)
        ]


def _study_case(
    setup: Setup, case: Case, n_command: int, seed: int, steps_ms: Sequence[int]
) -> list[Row]:
    commands = draw_commands(case, setup.vehicles, n_command, seed)
    truth = np.array([reference(setup, i, commands[i]) for i in range(len(VARIANTS))])
    speed = np.linalg.norm(truth[:, :, 7:10], axis=2).max(axis=1)
    level = 1 - 2 * (truth[:, :, 4] ** 2 + truth[:, :, 5] ** 2)
    tilt = np.degrees(np.arccos(np.clip(level, -1, 1))).max(axis=1)
    rows = []
    for step_ms in steps_ms:
        error = {
            name: np.linalg.norm(
                simulate(setup, scheme, commands, step_ms) - truth[:, :, :3], axis=2
            ).max(axis=1)
            for name, scheme in SCHEMES.items()
        }
        rows += [
            Row(
                case=case.name,
                vehicle=vehicle,
                parameter_set=chosen,
                greatest_speed_mps=float(speed[i]),
                greatest_tilt_deg=float(tilt[i]),
                step_ms=step_ms,
                error_cm={name: 100 * float(value[i]) for name, value in error.items()},
            )
            for i, (vehicle, chosen) in enumerate(VARIANTS)
        ]
    return sorted(rows, key=lambda row: VARIANTS.index((row.vehicle, row.parameter_set)))


def to_markdown(rows: Sequence[Row]) -> str:
    """The table as a person reads it: greatest position error in cm."""
    schemes = list(rows[0].error_cm)
    head = ["case", "vehicle, set", "step, ms", *schemes]
    lines = [" | ".join(head), " | ".join(["---"] * 2 + ["---:"] * (len(head) - 2))]
    for row in rows:
        case = f"{row.case} (to {row.greatest_speed_mps:.1f} m/s, {row.greatest_tilt_deg:.0f}°)"
        cells = [case, f"{row.vehicle}, {row.parameter_set}", str(row.step_ms)]
        cells += [_centimetres(row.error_cm[scheme]) for scheme in schemes]
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines)


def _centimetres(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}" if value < 1e4 else "blows up"


def write_between_markers(path: Path, text: str) -> None:
    """Replace what stands between the two marker lines of a file.

    Raises:
        ConfigError: the file cannot be read, or has not both markers in order.
    """
    try:
        old = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    begin, end = (old.find(marker) for marker in MARKERS)
    if not 0 <= begin < end:
        raise ConfigError(f"{path}: needs the lines {MARKERS[0]} and {MARKERS[1]}, in this order")
    head = old[: begin + len(MARKERS[0])]
    path.write_text(f"{head}\n{text}\n{old[end:]}", encoding="utf-8")


def main(out: Path | None = None, seconds: float = 60.0) -> list[Row]:
    """Compare the schemes and print the table.

    Args:
        out: Markdown file to write the table to, between its marker lines.
        seconds: length of each run.
    """
    rows = study(seconds)
    table = to_markdown(rows)
    print(table)
    if out is not None:
        write_between_markers(out, table)
    return rows


if __name__ == "__main__":
    tyro.cli(main)
