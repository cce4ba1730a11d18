"""Random worlds for the engines, without planner or file: every vehicle and set, every obstacle."""

import re
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.variation import Variation
from angler_mjx.sim import fleet
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.mjx import MjxEngine
from angler_mjx.sim.fleet import Fleet, Member, Variant
from angler_mjx.sim.state import FleetWorld, SimSpec, World
from angler_mjx.world import currents, obstacles
from angler_mjx.world.currents import (
    DoubleGyreConfig,
    GaussMarkovConfig,
    RankineConfig,
    UniformConfig,
    VorticesConfig,
)
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import ObstaclesConfig
from angler_mjx.world.rock.grid import Grid

from ..cuda_on_cpu import needs_nvrtc
from .armed import armed_run, armed_scenario
from .compiling import quickly
from .small import scenario, scenario_file

__all__ = ["armed_run", "armed_scenario", "scenario", "scenario_file"]

CELLS, CELL_M = 6, 1.5
ORIGIN_M = np.array([-4.5, -4.5, -12.0])
POINTS = 20
"""Way-points of a path: so many that engines keep them in memory, as they do a planner's."""
HORIZON_S = 20.0
NO_OBSTACLES = ObstaclesConfig()
ALL_OBSTACLES = ObstaclesConfig.model_validate(
    {
        "dynamic": {"count": 3, "cube_fraction": 0.5},
        "explicit": [
            {"type": "box", "position_m": [3.0, 3.0, -5.0], "size_m": [0.5, 1.0, 0.4]},
            {
                "type": "capsule",
                "position_m": [-3.0, 2.0, -8.0],
                "radius_m": 0.2,
                "length_m": 0.5,
                "motion": {"type": "straight", "velocity_mps": [0.3, 0.1, -0.1]},
            },
            {
                "type": "sphere",
                "position_m": [0.0, -3.0, -6.0],
                "radius_m": 0.4,
                "motion": {"type": "sine", "amplitude_m": [1.0, 0.0, 0.5], "period_s": 9.0},
            },
            {
                "type": "box",
                "position_m": [2.0, -1.0, -9.0],
                "size_m": [0.6, 0.6, 0.6],
                "motion": {"type": "circle", "radius_m": 1.0, "period_s": 12.0},
            },
        ],
    }
)
CURRENT = (
    UniformConfig(velocity_mps=(0.05, -0.1, 0.02)),
    GaussMarkovConfig(max_speed_mps=0.2, knot_dt_s=1.0),
    VorticesConfig(count=2, peak_speed_mps=(0.2, 0.4), core_radius_m=(1.0, 2.0)),
    RankineConfig(count=1, peak_speed_mps=(0.1, 0.2), core_radius_m=(1.0, 2.0)),
    DoubleGyreConfig(peak_speed_mps=0.1, epsilon=0.2, period_s=20.0),
)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What the engines take."""

    spec: SimSpec
    fleet: Fleet
    worlds: World
    """[n] leads."""

    @property
    def equipped(self) -> FleetWorld:
        """The worlds with the parameters of their robots."""
        return fleet.add_parameters(self.fleet, self.worlds)


OTHERWISE = Variation(
    mass=0.97,
    buoyancy=1.015,
    damping=(0.8, 1.3, 1.1, 0.7, 1.4, 0.9),
    added_mass=(1.2, 0.8, 1.1, 0.9, 1.3, 0.7),
    thrust=(0.9, 1.05, 0.95, 1.0, 0.85, 1.02),
)
"""How one robot differs from its file, untold."""


def every_variant() -> list[Member]:
    """A robot for each published set of each rigid shipped vehicle, and one that draws its set.

    The last is not what its file says, and its controllers do not know.
    """
    members = []
    for vehicle in reversed(library.list_rovs()):
        if library.load_vehicle(vehicle).links:
            continue
        kinds = [
            Variant(vehicle=vehicle, parameter_set=chosen, battery_v=16.0)
            for chosen in sorted(library.load_vehicle(vehicle).published_sets)
        ]
        members += [
            Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=0.5) for kind in kinds
        ]
    other = replace(members[-1].variants[0], variation=OTHERWISE)
    members[-1] = replace(members[-1], variants=(other,))
    heavy = members[0].variants[0].vehicle
    mix = tuple(kind for kind in fleet.list_variants(members) if kind.vehicle == heavy)
    return [Member(variants=mix, weights=(1.0,) * len(mix), cruise_speed_mps=0.4), *members]


ROBOTS = 6
"""Rows that are drawn at least; fleets of fewer take the first, so that all share one program."""


@partial(quickly, static_argnums=(0, 1))
def one_water(
    n: int, config: ObstaclesConfig, key: jax.Array
) -> tuple[Environment, Trajectory, jax.Array]:
    """Random cells, obstacles, current, starts and paths of ``n`` robots, and a key for these.

    Nothing keeps robots apart.
    """
    keys = iter(jax.random.split(key, 8))
    lo = jnp.asarray(ORIGIN_M, float)
    hi = lo + CELLS * CELL_M
    points = jax.random.uniform(next(keys), (n, 3, 3), float, lo + 0.8, hi - 0.8)
    # Starts on a lattice of 3 m, a little off: robots do not begin in each other, nor in a cell.
    sites = 3.0 * np.stack(np.unravel_index(np.arange(n), (3, 3, 3)), axis=1)
    off = jax.random.uniform(next(keys), (n, 3), float, 1.0, 2.0)
    points = points.at[:, 0].set(lo + sites + off)
    cell = jnp.floor((points[:, 0] - lo) / CELL_M).astype(jnp.int32)
    near = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    free = jnp.clip(cell[:, None] + near, 0, CELLS - 1).reshape(-1, 3)
    occupied = jax.random.bernoulli(next(keys), 0.3, (CELLS,) * 3)
    grid = Grid(
        occupied=occupied.at[free[:, 0], free[:, 1], free[:, 2]].set(False),
        origin_m=lo,
        cell_m=jnp.asarray(CELL_M, float),
    )
    path = jax.vmap(_polyline)(points)
    rows = obstacles.sample_obstacles(
        config.explicit,
        obstacles.DriftingSampler.of(config.dynamic),
        next(keys),
        grid,
        lo,
        hi,
        points[:, 0],
        0.5,
        1000.0,
    )
    of_fleet = next(keys)
    environment = Environment(
        grid=grid,
        floor_z_m=lo[2],
        obstacles=rows,
        current=currents.sample_current(
            currents.build_samplers(CURRENT, HORIZON_S), next(keys), lo, hi
        ),
        start_m=points[:, 0],
        start_yaw_rad=jax.random.uniform(next(keys), (n,), float, -3.0, 3.0),
        goal_m=points[:, -1],
        density=jnp.zeros(()),
        path_ratio=jnp.ones(n),
        line_free=jnp.ones(n, bool),
        redraws=jnp.zeros((), jnp.int32),
        valid=jnp.asarray(True),
    )
    return environment, path, of_fleet


def one_world(kinds: Fleet, draw: Any, config: ObstaclesConfig, key: jax.Array) -> World:
    """A world with robots that ``draw`` gives for a key, in numpy, in JAX's present float type."""
    n = kinds.cruise_mps.shape[0]
    with jax.enable_x64(True):
        environment, path, of_fleet = jax.device_get(one_water(max(n, ROBOTS), config, key))
    of_robots = ("start_m", "start_yaw_rad", "goal_m", "path_ratio", "line_free")
    rows = {name: getattr(environment, name)[:n] for name in of_robots}
    environment = replace(environment, **rows)
    path = jax.tree.map(lambda leaf: leaf[:n], path)
    variant, control = jax.device_get(draw(of_fleet))
    cruise = control.cruise_speed_mps
    world = World(environment=environment, variant=variant, cruise_speed_mps=cruise, path=path)
    return jax.tree.map(lambda leaf: leaf.astype(jax.dtypes.canonicalize_dtype(leaf.dtype)), world)


def _polyline(corners: jax.Array) -> Trajectory:
    """Two straight lines at half a metre a second; some of the `POINTS` points are padding."""
    share = jnp.clip(jnp.linspace(0.0, 2.4, POINTS), 0.0, 2.0)
    at = jnp.minimum(share.astype(jnp.int32), 1)
    point = corners[at] + (share - at)[:, None] * (corners[at + 1] - corners[at])
    leg = jnp.sqrt(jnp.sum(jnp.diff(point, axis=0) ** 2, axis=1))
    time = jnp.concatenate([jnp.zeros(1), jnp.cumsum(leg) / 0.5])
    return Trajectory(time_s=time, position_m=point, found=jnp.asarray(True))


def build_scene(
    n: int, *, seed: int = 0, members: Any = None, config: ObstaclesConfig = ALL_OBSTACLES
) -> Scene:
    """``n`` random worlds, in JAX's present float type."""
    kinds = fleet.build_fleet(every_variant() if members is None else members)
    draw = quickly(partial(fleet.sample_variants, kinds))
    # One after another: one program for any number of worlds.
    drawn = [
        one_world(kinds, draw, config, key) for key in jax.random.split(jax.random.key(seed), n)
    ]
    worlds = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *drawn)
    return Scene(spec=SimSpec(), fleet=kinds, worlds=worlds)


def one_robot(vehicle: str) -> list[Member]:
    """A fleet of one that draws its parameter set."""
    kinds = tuple(
        Variant(vehicle=vehicle, parameter_set=chosen, battery_v=16.0)
        for chosen in sorted(library.load_vehicle(vehicle).published_sets)
    )
    return [Member(variants=kinds, weights=(1.0,) * len(kinds), cruise_speed_mps=0.5)]


@pytest.fixture(scope="session")
def scenes():
    """The functions that build a scene and a fleet of one, and the two sets of obstacles."""
    return build_scene, one_robot, {"all": ALL_OBSTACLES, "none": NO_OBSTACLES}


STEPS = 200
"""Control steps of the comparisons: ten seconds, in which robots arrive, collide and go astray."""


@pytest.fixture(scope="session")
def engines_by_name():
    """The engines that are compared."""
    return {"mjx": MjxEngine(), "fused": FusedEngine()}


@pytest.fixture(scope="session")
def members():
    """The robots of the scenes that name none."""
    return every_variant()


@pytest.fixture(scope="session")
def double():
    """Worlds with everything, in float64."""
    with jax.enable_x64(True):
        return build_scene(8)


@pytest.fixture(scope="session")
def begun(engines_by_name):
    """A function (scene, engine) -> the state at t = 0; kept."""

    @cache
    def reset(name: str, scene: "Hashed") -> Any:
        with jax.enable_x64(True):
            one = partial(engines_by_name[name].reset, scene.scene.spec)
            # In numpy: a state that begins has the types of one that goes on.
            return jax.device_get(quickly(one)(scene.scene.fleet, scene.scene.worlds))

    return lambda scene, name: reset(name, Hashed(scene))


@pytest.fixture(scope="session")
def play(engines_by_name, begun):
    """A function (scene, engine, commanded) -> final state, samples of all steps; kept."""

    @cache
    def run(name: str, commanded: bool, scene: "Hashed") -> Any:
        with jax.enable_x64(True):
            engine, spec = engines_by_name[name], scene.scene.spec
            worlds, kinds = scene.scene.worlds, scene.scene.fleet
            start = begun(scene.scene, name)
            signals = random_signals(worlds) if commanded else None
            return quickly(partial(_steps, engine, spec))(kinds, worlds, start, signals)

    return lambda scene, name, commanded: run(name, commanded, Hashed(scene))


class Hashed:
    """A scene as a key: by identity."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def __hash__(self) -> int:
        return id(self.scene)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Hashed) and self.scene is other.scene


def random_signals(worlds: World) -> ThrusterPwm:
    """PWM [steps, W, R, 8] that changes every fifth step, dead band and full thrust included."""
    shape = (STEPS // 5, *worlds.variant.shape, 8)
    signals = np.random.default_rng(0).uniform(1300.0, 1700.0, shape)
    signals[::9] = 1500.0
    signals[4::9] = 1900.0
    return ThrusterPwm(pwm_us=jnp.asarray(np.repeat(signals, 5, axis=0), float))


def _steps(
    engine: Any, spec: SimSpec, kinds: Fleet, worlds: World, start: Any, signals: Any
) -> Any:
    def one(state: Any, command: Any) -> Any:
        return engine.control_step(spec, kinds, worlds, state, command)

    return jax.lax.scan(one, start, signals, length=STEPS)


@pytest.fixture
def as_if_on_an_h200(monkeypatch):
    """Kernels are compiled by NVRTC for a device that is not here."""
    needs_nvrtc()
    monkeypatch.setattr("angler_kernels.cuda.kernel_call._architecture", lambda: "compute_90")


@pytest.fixture
def lower_for_gpu(as_if_on_an_h200):
    """A function that lowers a function of arrays for a GPU: it is one kernel."""

    def lower(function: Any, *arrays: Any) -> None:
        text = jax.jit(function).trace(*arrays).lower(lowering_platforms=("cuda",)).as_text()
        assert re.findall(r"__gpu\$xla\.gpu\.(\w+)", text) == ["ptx"]

    return lower
