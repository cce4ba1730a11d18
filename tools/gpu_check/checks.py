"""All checks by name, and the coverage of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from angler_mjx.planning.register import built_in_device_planners
from angler_mjx.studies.speed.workloads import WORKLOADS
from tools.gpu_check import kernels, simulations, workloads
from tools.gpu_check.comparing import ErrorBound

type Run = Callable[[], Mapping[str, np.ndarray]]


@dataclass(frozen=True, kw_only=True)
class GpuCheck:
    """Check of the results."""

    name: str
    run: Run
    """Arrays by name; computed in a process for each device."""
    bounds: Mapping[str, ErrorBound] = field(default_factory=dict)
    covers: frozenset[str] = frozenset()
    """Covered parts, such as ``engine:mjx/xla``, ``kernel:angler_kernels.matching``,
    ``planner:grid``."""
    compared: bool = True
    """Whether results are compared with the CPU; else the check only has to end."""
    needs: tuple[str, ...] = ()
    """Packages without which the check is skipped."""


ROUNDING_REASON = "float32 rounds differently in each of 100 steps of numbers of order 10"


def _kernel_checks() -> list[GpuCheck]:
    """Build checks of each kernel; searches agree to the last bit."""
    bound = ErrorBound(atol=2e-4, why=ROUNDING_REASON)
    cases: dict[str, tuple[Run, dict[str, ErrorBound]]] = {
        "angler_kernels.matching": (kernels.run_matching, {}),
        "angler_mjx.world.tasks.pairs": (kernels.run_pairs, {}),
        "angler_mjx.planning.path_search.search_kernel": (kernels.run_reachable, {}),
        "angler_mjx.planning.current.search_kernel": (kernels.run_costs_to_goal, {}),
        "angler_mjx.world.path_length_kernel": (kernels.run_shortest_paths, {}),
        "angler_mjx.sim.engines.dynamics": (
            kernels.run_dynamics,
            dict.fromkeys(("p", "q", "nu"), bound),
        ),
    }
    return [
        GpuCheck(
            name=f"kernel/{module}",
            run=run,
            bounds=bounds,
            covers=frozenset({f"kernel:{module}"}),
        )
        for module, (run, bounds) in cases.items()
    ]


RECORDING = {"record_hz": 1.0}


def _flight_check(name: str, scenario: str, covers: set[str], **changes: object) -> GpuCheck:
    """Build a check of a flight on the fused engine; changes may choose its kernels."""
    return GpuCheck(
        name=f"flight/{name}",
        run=partial(simulations.fly_worlds, scenario, **{"engine": "fused", **changes}),
        bounds=simulations.BOUNDS,
        covers=frozenset({f"scenario:{scenario}", *covers}),
    )


def _flight_checks() -> list[GpuCheck]:
    """Build flights for every engine, device planner, policy, allocation and shipped scenario."""
    reef: dict[str, object] = {"worlds": 16, "time": RECORDING}
    brief: dict[str, object] = {"worlds": 8, "time": {**RECORDING, "horizon_s": 40.0}}
    cuda = {
        "engine:fused/xla",
        "engine:fused/cuda",
        "policy:none",
        "planner:grid",
        "kernel:angler_mjx.sim.engines.cuda",
    }
    replanning: dict[str, object] = {"replan_hz": 0.5, "information": {"obstacles": "observed"}}
    # The planner of cargo plans its own task alone, and before the start.
    planners = [name for name in built_in_device_planners() if name != "carry"]
    few = {"samples": 64}
    glide_time = {**RECORDING, "horizon_s": 80.0, "physics_dt_s": 0.02, "control_dt_s": 0.1}
    nearest = {"task": {"allocation": "nearest"}}
    return [
        _flight_check("reef_fleet", "reef_fleet", cuda, **reef),
        _flight_check("reef_fleet-xla", "reef_fleet", {"engine:fused/xla"}, kernels="xla", **reef),
        _flight_check("reef_fleet-mjx", "reef_fleet", {"engine:mjx/xla"}, engine="mjx", **reef),
        # 7 of 128 worlds of priority have plans of another duration, 2 of them among the first 16:
        # a fraction of 16 could not tell that from the bound.
        *(
            _flight_check(
                name,
                "reef_fleet",
                {f"planner:{name}"},
                planner={"name": name},
                **{**reef, "worlds": 64 if name == "priority" else 16},
            )
            for name in planners
            if name != "grid"
        ),
        _flight_check(
            "mppi", "reef_fleet", {"policy:mppi"}, policy={"name": "mppi", "mppi": few}, **brief
        ),
        _flight_check("routes", "reef_survey", {"policy:routes"}, **brief),
        _flight_check("delivery", "corridor_delivery", set(), **brief),
        _flight_check("delivery-mjx", "corridor_delivery", set(), engine="mjx", **brief, **nearest),
        *(
            _flight_check(
                f"replanning-{name}",
                "reef_fleet",
                {f"replanning:{name}"},
                planner={"name": name, **replanning},
                **brief,
            )
            for name in planners
        ),
        _flight_check("order", "reef_fleet", {"order:kept"}, execution={"order": "kept"}, **brief),
        _flight_check("dense_dynamic", "dense_dynamic", set(), **brief),
        _flight_check("heterogeneous", "heterogeneous", set(), **brief),
        _flight_check("open_water_current", "open_water_current", set(), **brief),
        _flight_check("bay_torpedoes", "bay_torpedoes", set(), **brief),
        _flight_check("shelf_gliders", "shelf_gliders", set(), worlds=8, time=glide_time),
        _flight_check("work_class", "work_class", set(), **brief),
        _flight_check("harbour_surface", "harbour_surface", set(), **brief),
        _flight_check("reef_arms", "reef_arms", {"policy:reach"}, engine="mjx", **brief),
        _flight_check("reef_debris", "reef_debris", set(), engine="mjx", **brief),
        _flight_check("carry_pipe", "carry_pipe", {"planner:carry"}, engine="mjx", **brief),
        _flight_check("carry_arms", "carry_arms", {"planner:carry"}, engine="mjx", **brief),
        _flight_check(
            "sitl_hold", "sitl_hold", set(), worlds=2, time={**RECORDING, "horizon_s": 40.0}
        ),
        _flight_check(
            "sitl_formation", "sitl_formation", set(), worlds=2, time={"horizon_s": 20.0}
        ),
    ]


def _workload_checks() -> list[GpuCheck]:
    return [
        GpuCheck(
            name=f"bench/{name}",
            run=partial(workloads.run_to_end, name),
            covers=frozenset({f"workload:{name}"}),
            compared=False,
        )
        for name in WORKLOADS
    ]


CHECKS: dict[str, GpuCheck] = {
    check.name: check for check in (*_flight_checks(), *_workload_checks(), *_kernel_checks())
}
"""Checks of computations, those that compile longest first."""

TESTS = "tests/gpu"
"""Check of the tests marked ``gpu``, run by pytest."""
RATES = [f"rate/{name}" for name in WORKLOADS]
"""Checks of rates, timed alone, after all others."""


def list_checks() -> list[str]:
    """Return all names in the order of running."""
    return [TESTS, *CHECKS, *RATES]
