"""All checks by name, and what each of them covers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from angler_mjx.studies.speed.workloads import WORKLOADS
from tools.gpu_check import kernels, simulations, workloads
from tools.gpu_check.comparing import ErrorBound

type Run = Callable[[], Mapping[str, np.ndarray]]


@dataclass(frozen=True, kw_only=True)
class GpuCheck:
    """One line of the results."""

    name: str
    run: Run
    """Arrays by name; computed in a process for each device."""
    bounds: Mapping[str, ErrorBound] = field(default_factory=dict)
    covers: frozenset[str] = frozenset()
    """Such as ``engine:mjx/xla``, ``kernel:angler_kernels.matching``, ``planner:grid``."""
    compared: bool = True
    """Whether the CPU computes the same; else it only has to end."""
    needs: tuple[str, ...] = ()
    """Packages without which the check is skipped."""


WATER = "float32 rounds differently in each of 100 steps of numbers of order 10"


def _kernels() -> list[GpuCheck]:
    free = ErrorBound(atol=2e-4, why=WATER)
    found: list[tuple[str, Run, dict[str, ErrorBound]]] = [
        ("angler_kernels.matching", kernels.matching, {}),
        ("angler_mjx.world.tasks.pairs", kernels.pairs, {}),
        ("angler_mjx.planning.path_search.search_kernel", kernels.reachable, {}),
        ("angler_mjx.planning.current.search_kernel", kernels.costs_to_goal, {}),
        ("angler_mjx.world.path_length_kernel", kernels.shortest_ways, {}),
        ("angler_mjx.sim.engines.dynamics", kernels.dynamics, {"p": free, "q": free, "nu": free}),
    ]
    return [
        GpuCheck(name=f"kernel/{of}", run=run, bounds=bounds, covers=frozenset({f"kernel:{of}"}))
        for of, run, bounds in found
    ]


FAST = {"record_hz": 1.0}


def _flight(name: str, scenario: str, covers: set[str], **changes: Any) -> GpuCheck:
    """Fly a scenario on the fused engine, with its default kernels, unless changes say another."""
    return GpuCheck(
        name=f"flight/{name}",
        run=partial(simulations.fly, scenario, **{"engine": "fused", **changes}),
        bounds=simulations.BOUNDS,
        covers=frozenset({f"scenario:{scenario}", *covers}),
    )


def _flights() -> list[GpuCheck]:
    """Every engine, device planner, policy, allocation and shipped scenario."""
    reef: dict[str, Any] = {"worlds": 16, "time": FAST}
    brief: dict[str, Any] = {"worlds": 8, "time": {**FAST, "horizon_s": 40.0}}
    triton = {
        "engine:fused/xla",
        "engine:fused/triton",
        "policy:none",
        "planner:grid",
        "kernel:angler_mjx.sim.engines.triton",
    }
    anew: dict[str, Any] = {"replan_hz": 0.5, "knows": {"obstacles": "observed"}}
    few = {"samples": 64}
    nearest = {"task": {"allocation": "nearest"}}
    return [
        _flight("reef_fleet", "reef_fleet", triton, **reef),
        _flight("reef_fleet-xla", "reef_fleet", {"engine:fused/xla"}, kernels="xla", **reef),
        _flight("reef_fleet-mjx", "reef_fleet", {"engine:mjx/xla"}, engine="mjx", **reef),
        # 7 of 128 worlds have plans of another duration, 2 of them among the first 16: a share of
        # 16 could not tell that from the bound.
        _flight(
            "priority",
            "reef_fleet",
            {"planner:priority"},
            planner={"name": "priority"},
            **{**reef, "worlds": 64},
        ),
        _flight("current", "reef_fleet", {"planner:current"}, planner={"name": "current"}, **reef),
        _flight(
            "mppi", "reef_fleet", {"policy:mppi"}, policy={"name": "mppi", "mppi": few}, **brief
        ),
        _flight("routes", "reef_survey", {"policy:routes"}, **brief),
        _flight("delivery", "corridor_delivery", set(), **brief),
        _flight("delivery-mjx", "corridor_delivery", set(), engine="mjx", **brief, **nearest),
        *(
            _flight(
                f"replanning-{name}",
                "reef_fleet",
                {f"replanning:{name}"},
                planner={"name": name, **anew},
                **brief,
            )
            for name in ("grid", "priority", "current")
        ),
        _flight("order", "reef_fleet", {"order:kept"}, execution={"order": "kept"}, **brief),
        _flight("dense_dynamic", "dense_dynamic", set(), **brief),
        _flight("heterogeneous", "heterogeneous", set(), **brief),
        _flight("open_water_current", "open_water_current", set(), **brief),
        _flight("sitl_hold", "sitl_hold", set(), worlds=2, time={**FAST, "horizon_s": 40.0}),
        _flight("sitl_formation", "sitl_formation", set(), worlds=2, time={"horizon_s": 20.0}),
    ]


def _workloads() -> list[GpuCheck]:
    return [
        GpuCheck(
            name=f"bench/{name}",
            run=partial(workloads.end, name),
            covers=frozenset({f"workload:{name}"}),
            compared=False,
        )
        for name in WORKLOADS
    ]


CHECKS: dict[str, GpuCheck] = {
    check.name: check for check in (*_flights(), *_workloads(), *_kernels())
}
"""Those that compile longest come first."""

TESTS = "tests/gpu"
"""The tests marked ``gpu``, run by pytest."""
RATES = [f"rate/{name}" for name in WORKLOADS]
"""Timed alone, after all others."""


def names() -> list[str]:
    """Return all names in the order of running."""
    return [TESTS, *CHECKS, *RATES]
