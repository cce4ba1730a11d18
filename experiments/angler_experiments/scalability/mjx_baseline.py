"""Baseline of MuJoCo MJX: the vehicle as a free body, no water, no control, no worlds.

Cost of `mjx.step`, beside which the equations of motion of `angler_mjx.studies.speed` are measured.
"""

import contextlib
import io

import jax
import jax.numpy as jnp

from angler_mjx.robot.vehicles import library, mjcf
from angler_mjx.studies.speed.measured.free_motion import (
    PARAMETER_SET,
    PHYSICS_DT_S,
    VEHICLE,
    steps_of,
)
from angler_mjx.studies.speed.rows import (
    SpeedRow,
    all_finite,
    iterate_turns,
    read_program_costs,
    seconds_of,
    summarise_rates,
)

STEP_DIVISOR = 10
"""Factor by which the equations of motion are repeated more often in a call."""


def measure_mjx(*, vehicles: int, repeats: int) -> SpeedRow:
    """Time `mjx.step` of independent free bodies.

    Args:
        vehicles: vehicles in one device call, one in each world.
        repeats: timed calls, after some untimed ones.

    Returns:
        Rates in vehicle-steps/s.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # it prints that Warp is missing
        from mujoco import mjx
    spec = mjcf.to_spec(library.load_vehicle(VEHICLE), PARAMETER_SET, shapes=False)
    spec.option.timestep = PHYSICS_DT_S
    model = mjx.put_model(spec.compile())
    steps = max(1, steps_of(vehicles, jax.default_backend()) // STEP_DIVISOR)

    def init_data(speed: jax.Array) -> mjx.Data:
        return mjx.make_data(model).replace(qvel=speed)

    def step_many(data: mjx.Data) -> mjx.Data:
        def step(data: mjx.Data, _: None) -> tuple[mjx.Data, None]:
            return jax.vmap(mjx.step, in_axes=(None, 0))(model, data), None

        return jax.lax.scan(step, data, None, length=steps)[0]

    speeds = jax.random.uniform(jax.random.key(0), (vehicles, 6), minval=0.1, maxval=0.5)
    data = jax.block_until_ready(jax.jit(jax.vmap(init_data))(speeds))
    compile_s, program = seconds_of(jax.jit(step_many).lower(data).compile)
    rates = []
    for counts in iterate_turns(repeats):
        elapsed_s, final_data = seconds_of(program, data)
        if not all_finite(final_data.qpos) or bool(
            jnp.any(final_data.qpos[:, :3] == data.qpos[:, :3])
        ):
            raise RuntimeError("bodies stood still, or their places are not finite")
        rates += [vehicles * steps / elapsed_s] * counts
    return SpeedRow(
        workload="dynamics",
        inside=f"{steps} calls of mjx.step in one device call: one free body in each world",
        worlds=vehicles,
        robots=1,
        unit="vehicle-steps/s",
        **summarise_rates(rates),
        compile_s=compile_s,
        engine="mjx",
        kernels="xla",
        **read_program_costs(program),
        active_share=1.0,
    )
