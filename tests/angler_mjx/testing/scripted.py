"""Robots on rails, judged by the simulator's own functions, stored as a run stores them.

What moves the robots is written down here, and so cheap that everything that can end an episode
happens at once: nothing but a control step's judgement is compiled.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.vehicles import library, params
from angler_mjx.runs.storage.episode_columns import TileResult
from angler_mjx.runs.storage.results import episode_table
from angler_mjx.sim import robot
from angler_mjx.sim.detection import detect_contacts
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import Outcome, SimSpec
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import Obstacles, ObstacleState
from angler_mjx.world.rock.grid import Grid

from ..compiling import quickly
from .hand_made import CELLS, DT_S, EDGE_M, FLOOR_M, LOW_M, Ball, Flight

STEPS = 60
SPEC = SimSpec()


def _environment(rock, balls, goals):
    n = len(balls)
    occupied = np.zeros(CELLS, bool)
    for cell in rock:
        occupied[cell] = True
    still = [0 if ball.v_mps == (0.0, 0.0, 0.0) else 2 for ball in balls]
    obstacles = Obstacles(
        kind=np.zeros(n, np.int32),
        size_m=np.array([(ball.r_m, 0.0, 0.0) for ball in balls], np.float32),
        motion=np.array(still, np.int32),
        path=np.zeros((n, 8), np.float32),
        p0=np.array([ball.p_m for ball in balls], np.float32),
        q0=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        nu0=np.zeros((n, 6), np.float32),
        mass_kg=np.ones(n, np.float32),
        inertia_kgm2=np.ones((n, 3), np.float32),
        volume_m3=np.ones(n, np.float32),
        M_A=np.zeros((n, 6), np.float32),
        D_l=np.zeros((n, 6), np.float32),
        D_q=np.zeros((n, 6), np.float32),
        exists=np.ones(n, bool),
        kinds=(0,),
        motions=(0, 2),
    )
    r = len(goals)
    low = np.array(LOW_M, np.float32)
    return Environment(
        grid=Grid(occupied=occupied, origin_m=low, cell_m=np.float32(EDGE_M)),
        floor_z_m=np.float32(FLOOR_M),
        obstacles=obstacles,
        current=(),
        start_m=np.zeros((r, 3), np.float32),
        start_yaw_rad=np.zeros(r, np.float32),
        goal_m=np.array(goals, np.float32),
        density=np.float32(0.0),
        path_ratio=np.ones(r, np.float32),
        line_free=np.ones(r, bool),
        redraws=np.int32(0),
        valid=np.bool_(True),
    )


def fly(robots, rock, balls, pwm, place):
    """Fly robots along straight lines, level, and judge them step by step as the simulator does.

    Args:
        robots: of each the entry of its fleet, its start, velocity and goal.
        rock: occupied cells.
        balls: obstacles.
        pwm: [STEPS, R, 8].
        place: folder of the vehicle files that entries name.

    Returns:
        The flight, with the rows that a run would have.
    """
    entries, starts, velocities, goals = zip(*robots, strict=True)
    configs = [library.load_vehicle(str(place / entry["vehicle"])) for entry in entries]
    vehicles = params.stack_vehicles(
        [
            params.build_vehicle(config, None, 16.0, thruster_health=entry.get("thruster_health"))
            for config, entry in zip(configs, entries, strict=True)
        ]
    )
    environment = jax.tree.map(jnp.asarray, _environment(rock, balls, goals))
    v = np.array(velocities, np.float32)
    ball_v = np.array([ball.v_mps for ball in balls], np.float32)
    low = np.array(LOW_M, np.float32)
    high = low + np.float32(EDGE_M) * np.array(CELLS, np.float32)
    n = len(robots)
    still = VehicleState(
        p=jnp.asarray(starts, jnp.float32),
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, 1)),
        nu=jnp.zeros((n, 6)),
        force_before=jnp.zeros((n, 6)),
        thrust=jnp.zeros((n, vehicles.B.shape[-1])),
    )

    def obstacles_at(k):
        p = environment.obstacles.p0 + k * DT_S * ball_v
        nu = jnp.concatenate([ball_v, jnp.zeros_like(ball_v)], axis=1)
        return ObstacleState(p=p, q=environment.obstacles.q0, nu=nu, nu_dot=jnp.zeros_like(nu))

    def step(carry, given):
        before, tally = carry
        k, signals = given
        _, power = jax.vmap(robot.thrust_and_power)(vehicles, ThrusterPwm(pwm_us=signals))
        moved = VehicleState(
            p=before.p + DT_S * v,
            q=before.q,
            nu=jnp.concatenate([jnp.asarray(v), jnp.zeros((n, 3))], axis=1),
            force_before=before.force_before,
            thrust=before.thrust,
        )
        after, broken = jax.vmap(robot.hold_if_ended)(tally.outcome, before, moved)
        contact = detect_contacts(environment, vehicles, after, obstacles_at(k + 1))
        new = jax.vmap(partial(robot.update_tally, SPEC), (0, None, None, 0, 0, 0, 0, 0, 0, None))(
            environment.goal_m,
            low,
            high,
            tally,
            before.p,
            after.p,
            contact,
            power,
            broken,
            k * jnp.float32(DT_S),
        )
        return (after, new), (after, new.outcome)

    @quickly
    def run(signals):
        contact = detect_contacts(environment, vehicles, still, obstacles_at(0))
        tally = robot.begin_tally(contact, jnp.float32)
        given = (jnp.arange(STEPS, dtype=jnp.float32), signals)
        return jax.lax.scan(step, (still, tally), given)

    (last, tally), (states, outcomes) = jax.device_get(run(jnp.asarray(pwm, jnp.float32)))
    first = jax.device_get(still)
    outcome = np.where(tally.outcome == Outcome.RUNNING, Outcome.TIMEOUT, tally.outcome)
    result = TileResult(
        world=np.zeros(1, int),
        variant=np.arange(n)[None],
        planned=np.ones((1, n), bool),
        outcome=outcome[None],
        p=last.p[None],
        tally=jax.tree.map(lambda leaf: leaf[None], tally),
        kept={
            "redraws": np.zeros(1, int),
            "plan_length_m": np.zeros((1, n)),
            "plan_end_s": np.zeros((1, n)),
        },
    )
    names = [(config.name, config.default_set) for config in configs]
    time = DT_S * np.arange(STEPS + 1, dtype=np.float32)[:, None, None]
    return Flight(
        p=np.concatenate([first.p[None], states.p]),
        nu=np.concatenate([first.nu[None], states.nu]),
        q=np.concatenate([first.q[None], states.q]),
        pwm=pwm,
        outcome=np.concatenate([np.zeros((1, n), int), outcomes]),
        goal=np.array(goals),
        rows=episode_table(result, names, 0).to_pylist(),
        rock=rock,
        balls=balls,
        obstacle_p=environment.obstacles.p0 + time * ball_v,
        fleet=tuple({**entry, "vehicle": str(place / entry["vehicle"])} for entry in entries),
    )


__all__ = ["STEPS", "Ball", "fly"]
