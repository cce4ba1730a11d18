"""Study that selected the discretisation: five schemes of a step, against DOP853.

All of them step the same equations, those of `angler_mjx.sim.physics`, in float64: four vehicles
with rotor lag, in a uniform current with one vortex, under random thruster commands that change
every 0.2 s. The measure is the greatest distance from the reference at any of these changes.

    python -m angler_experiments.convergence

prints the table; `angler validate` puts it on the page.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from angler_experiments.shared import schemes
from angler_kernels import quaternion
from angler_kernels.current_field import lamb_oseen_circulation
from angler_mjx.robot.control import allocation
from angler_mjx.robot.vehicles import library, mjcf, params
from angler_mjx.robot.vehicles.params import VehicleParams
from angler_mjx.sim.physics import mjx_engine, step
from angler_mjx.sim.physics.mjx_engine import BodyInertia, MjxPhysics
from angler_mjx.sim.physics.step import VehicleState, Water
from angler_mjx.testing.validation.results import StudyNumber, save_result
from angler_mjx.world.currents import Current, Uniform, Vortices

HOLD_S = 0.2
"""Interval between changes of a thruster command."""


@dataclass(frozen=True, kw_only=True)
class DrivingCase:
    """How roughly the vehicles are driven."""

    name: str
    speed_mps: float
    """Amplitude of surge, sway and heave: the force that drag exerts at this speed."""
    tilt_rad: float
    """Amplitude of the moments about x and y: what holds the vehicle at this tilt."""
    moment_nm: tuple[float, float, float]
    """Amplitude of further moments about x, y, z."""
    memory: float
    """Correlation of a command with the one 0.2 s before."""


CASES = (
    DrivingCase(
        name="moderate", speed_mps=0.22, tilt_rad=0.03, moment_nm=(0.0, 0.0, 0.6), memory=0.95
    ),
    DrivingCase(name="violent", speed_mps=1.2, tilt_rad=0.0, moment_nm=(8.0, 8.0, 6.0), memory=0.5),
)


type Array = NDArray[np.float64]

VARIANTS = (
    ("bluerov2_heavy", "wu2018"),
    ("bluerov2_heavy", "von_benzon2022"),
    ("bluerov2_heavy", "blue_gazebo"),
    ("bluerov2", "blue_gazebo"),
)
STEPS_MS = (40, 20, 10, 5)
BATTERY_V = 16.0


@dataclass(frozen=True, kw_only=True)
class ConvergenceSetup:
    """Vehicles [n_variant], and the water that they are in."""

    engine: MjxPhysics
    body: BodyInertia
    vehicles: VehicleParams
    current: Current


@dataclass(frozen=True, kw_only=True)
class ConvergenceRow:
    """Line of the table."""

    case: str
    vehicle: str
    parameter_set: str
    greatest_speed_mps: float
    greatest_tilt_deg: float
    step_ms: int
    error_cm: dict[str, float]
    """Error by scheme; NaN after divergence."""


def sample_commands(
    case: DrivingCase, vehicles: VehicleParams, n: int, seed: int
) -> NDArray[np.float64]:
    """Thrusts [n_variant, n, n_thruster] N that settle random wrenches, held for 0.2 s each."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(-1.0, 1.0, (n, 6)) * math.sqrt(3.0)
    for k in range(1, n):
        noise[k] = case.memory * noise[k - 1] + math.sqrt(1 - case.memory**2) * noise[k]
    linear, quadratic = np.asarray(vehicles.D_l)[:, :3], np.asarray(vehicles.D_q)[:, :3]
    force = (linear + quadratic * case.speed_mps) * case.speed_mps
    volume, p_cb = np.asarray(vehicles.volume_m3), np.asarray(vehicles.p_cb_m)
    righting = Water().density_kgpm3 * Water().gravity_mps2 * volume * p_cb[:, 2]
    moment = case.tilt_rad * righting[:, None] * np.array([1, 1, 0]) + case.moment_nm
    amplitude = np.concatenate([force, moment], axis=1)
    inverse = np.asarray(allocation.build_allocation(vehicles).B_inverse)
    thrust = np.einsum("vti,vi,ki->vkt", inverse, amplitude / 2, noise)
    ends = np.asarray(vehicles.thrust_n)[:, None, [0, -1]]
    clipped: NDArray[np.float64] = np.clip(thrust, ends[..., :1], ends[..., 1:])
    return clipped


def build_setup(variants: Sequence[tuple[str, str]]) -> ConvergenceSetup:
    """Compile the vehicles and the current in JAX's present float type."""
    configs = [(library.load_vehicle(vehicle), chosen) for vehicle, chosen in variants]
    engine, body = mjx_engine.build_engine(
        [mjcf.to_spec(config, chosen, shapes=False) for config, chosen in configs]
    )
    core = jnp.array([1.5])
    vortex = Vortices(
        centre_m=jnp.array([[1.0, 0.5]]),
        circulation_m2ps=lamb_oseen_circulation(jnp.array([0.3]), core),
        core_m=core,
    )
    return ConvergenceSetup(
        engine=engine,
        body=body,
        vehicles=params.stack_vehicles(
            [params.build_vehicle(c, chosen, BATTERY_V) for c, chosen in configs]
        ),
        current=(Uniform(velocity_mps=jnp.array([0.15, 0.1, 0.0])), vortex),
    )


def first_state(n_thruster: int) -> VehicleState:
    """Return the state of a vehicle at rest in the middle of the water column."""
    return VehicleState(
        p=jnp.array([0.0, 0.0, -30.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.zeros(6),
        force_before=jnp.zeros(6),
        thrust=jnp.zeros(n_thruster),
    )


def build_simulator(
    setup: ConvergenceSetup, scheme: schemes.Scheme
) -> Callable[[Array, int], Array]:
    """Build a function (commands, step_ms) -> positions [n_variant, n_command, 3] by command."""

    def simulate_vehicle(
        body: BodyInertia,
        vehicle: VehicleParams,
        commands: jax.Array,
        dt: jax.Array,
        steps: jax.Array,
    ) -> jax.Array:
        # The current is steady, so the time is arbitrary.
        zero, water = jnp.zeros(()), Water()
        state = first_state(commands.shape[-1])
        state = step.start_multistep(setup.engine, body, vehicle, state, setup.current, zero, water)

        def hold(state: VehicleState, command: jax.Array) -> tuple[VehicleState, jax.Array]:
            def take_step(_: jax.Array, state: VehicleState) -> VehicleState:
                return scheme(
                    setup.engine, body, vehicle, state, command, setup.current, zero, dt, water
                )

            # A traced number of steps: one compilation per scheme, for any step.
            state = jax.lax.fori_loop(0, steps, take_step, state)
            return state, state.p

        return jax.lax.scan(hold, state, commands)[1]

    simulate_all = jax.jit(jax.vmap(simulate_vehicle, (0, 0, 0, None, None)))

    def run(commands: Array, step_ms: int) -> Array:
        steps = round(HOLD_S * 1e3 / step_ms)
        return np.asarray(simulate_all(setup.body, setup.vehicles, commands, HOLD_S / steps, steps))

    return run


def integrate_reference(setup: ConvergenceSetup, commands: Array) -> Array:
    """Return states [n_variant, n_command, 13 + n_thruster] by DOP853, after each command."""
    n, n_thruster = len(commands), commands.shape[-1]
    start = first_state(n_thruster)

    def state_rate(
        body: BodyInertia, vehicle: VehicleParams, y: jax.Array, f: jax.Array
    ) -> jax.Array:
        state = replace(start, p=y[:3], q=y[3:7], nu=y[7:13], thrust=y[13:])
        zero = jnp.zeros(())
        a = schemes.accelerate(
            setup.engine, body, vehicle, state, state.thrust, setup.current, zero, Water()
        )
        spin = jnp.concatenate([jnp.zeros(1), state.nu[3:]])
        turn = 0.5 * quaternion.multiply(state.q, spin)
        lag = (f - state.thrust) / vehicle.tau_s
        return jnp.concatenate([quaternion.rotate(state.q, state.nu[:3]), turn, a, lag])

    # The setup is closed over, not passed: its hundreds of leaves would be counted at every call.
    @jax.jit
    def rate(y: jax.Array, command: jax.Array) -> jax.Array:
        rows = jax.vmap(state_rate)(setup.body, setup.vehicles, y.reshape(n, -1), command)
        return jnp.ravel(rows)

    y = np.tile(np.concatenate([start.p, start.q, start.nu, start.thrust]), n)
    states = []
    for command in commands.swapaxes(0, 1):
        solved = solve_ivp(
            lambda _, y, command=command: np.asarray(rate(y, command)),
            (0, HOLD_S),
            y,
            "DOP853",
            rtol=1e-10,
            atol=1e-12,
        )
        rows = solved.y[:, -1].reshape(n, -1)
        rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
        y = rows.ravel()
        states.append(rows)
    return np.stack(states, axis=1)


def run_study(
    seconds: float = 60.0,
    cases: Sequence[DrivingCase] = CASES,
    steps_ms: Sequence[int] = STEPS_MS,
    variants: Sequence[tuple[str, str]] = VARIANTS,
    names: Sequence[str] = tuple(schemes.SCHEMES),
) -> list[ConvergenceRow]:
    """Run all schemes against the reference, in float64.

    Args:
        seconds: length of each run.
        cases: driving cases.
        steps_ms: divisors of 200.
        variants: vehicles and their parameter sets.
        names: names of the schemes.

    Returns:
        Rows by case, vehicle and step.
    """
    n_command = round(seconds / HOLD_S)
    rows = []
    with jax.enable_x64(True):
        setup = build_setup(variants)
        runs = {name: build_simulator(setup, schemes.SCHEMES[name]) for name in names}
        for seed, case in enumerate(cases):
            commands = sample_commands(case, setup.vehicles, n_command, seed)
            truth = integrate_reference(setup, commands)
            error = {
                (name, step_ms): _greatest_distance(run(commands, step_ms), truth)
                for name, run in runs.items()
                for step_ms in steps_ms
            }
            rows += [
                ConvergenceRow(
                    case=case.name,
                    vehicle=vehicle,
                    parameter_set=chosen,
                    greatest_speed_mps=float(np.linalg.norm(truth[i, :, 7:10], axis=1).max()),
                    greatest_tilt_deg=_greatest_tilt_deg(truth[i, :, 3:7]),
                    step_ms=step_ms,
                    error_cm={name: 100 * float(error[name, step_ms][i]) for name in runs},
                )
                for i, (vehicle, chosen) in enumerate(variants)
                for step_ms in steps_ms
            ]
    return rows


def _greatest_distance(positions: Array, truth: Array) -> Array:
    distance: Array = np.linalg.norm(positions - truth[:, :, :3], axis=2).max(axis=1)
    return distance


def _greatest_tilt_deg(q: Array) -> float:
    up = 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2)
    return float(np.degrees(np.arccos(np.clip(up, -1, 1))).max())


def to_markdown(rows: Sequence[ConvergenceRow]) -> str:
    """Format the table of greatest position errors in cm."""
    names = list(rows[0].error_cm)
    head = ["case", "vehicle, set", "step, ms", *names]
    lines = [" | ".join(head), " | ".join(["---"] * 2 + ["---:"] * (len(head) - 2))]
    for row in rows:
        case = f"{row.case} (to {row.greatest_speed_mps:.1f} m/s, {row.greatest_tilt_deg:.0f}°)"
        cells = [case, f"{row.vehicle}, {row.parameter_set}", str(row.step_ms)]
        cells += [_format_centimetres(row.error_cm[scheme]) for scheme in names]
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines)


def _format_centimetres(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}" if value < 1e4 else "blows up"


def result_numbers(rows: Sequence[ConvergenceRow]) -> Mapping[str, StudyNumber]:
    """Return the errors of the adopted scheme, by case, vehicle, set and step."""
    return {
        f"{row.case}.{row.vehicle}.{row.parameter_set}.{row.step_ms}_ms": StudyNumber(
            value=row.error_cm["ours"], unit="cm", worse="scheme"
        )
        for row in rows
    }


def main(
    json: Path | None = None, seconds: float = 60.0, quick: bool = False
) -> list[ConvergenceRow]:
    """Compare the schemes and print the table.

    Args:
        json: File for the result, as `angler validate` reads it.
        seconds: Length of each run.
        quick: Only the adopted scheme, at its default step, in moderate manoeuvres.
    """
    rows = (
        run_study(seconds, cases=CASES[:1], steps_ms=(10,), names=("ours",))
        if quick
        else run_study(seconds)
    )
    table = to_markdown(rows)
    print(table)
    if json is not None:
        save_result(json, dict(result_numbers(rows)), table)
    return rows


if __name__ == "__main__":
    tyro.cli(main)
