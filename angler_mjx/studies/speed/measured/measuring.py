"""One workload after the other, each made a row: with its number, or with the reason for none."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import jax

from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.progress import Progress
from angler_mjx.runs.simulator import devices
from angler_mjx.studies.speed.measured import (
    arm_motion,
    compilation,
    environments,
    free_motion,
    graph_search,
    hull_clearance,
    recording,
    simulation,
)
from angler_mjx.studies.speed.rows import HITS, SpeedRow, cache_events, peak_device_bytes
from angler_mjx.studies.speed.workloads import WorkloadCase


def measure_cases(
    chosen: list[WorkloadCase],
    begin: Callable[[WorkloadCase], None],
    progress: Progress | None = None,
) -> Iterator[SpeedRow]:
    """Measure one case after the other.

    A case gives a row, or several where it compiles. A case that is refused gives a row without a
    number. After one that lacks memory, larger ones of the same kind are left out.

    Args:
        chosen: from `cases`.
        begin: told of each case before it is measured.
        progress: receives steps and turns of simulations, recording and preparation.
    """
    progress = progress or Progress()
    full: set[tuple[str, int]] = set()
    for case in chosen:
        if (case.label, case.robots) in full:
            continue
        begin(case)
        before = cache_events()[HITS]
        rows = _measure_or_refuse(case, progress)
        if case.workload.kind != "compilation":
            hits = cache_events()[HITS] - before
            rows = [replace(row, cached_programs=hits) for row in rows]
        if any(row.out_of_memory for row in rows):
            full.add((case.label, case.robots))
        yield from rows
        # Programs of the case before hold device memory that the next one may need.
        jax.clear_caches()


def _measure_or_refuse(case: WorkloadCase, progress: Progress) -> list[SpeedRow]:
    try:
        return _measure_case(case, progress)
    except AnglerError as error:
        return [
            _build_refused_row(case, str(error), devices.is_out_of_memory(error.__cause__ or error))
        ]
    except jax.errors.JaxRuntimeError as error:
        if not devices.is_out_of_memory(error):
            raise
        fits = _largest_that_fits(case, progress)
        return [
            _build_refused_row(case, f"out of device memory; {fits} worlds in one call fit", True)
        ]


def _measure_case(case: WorkloadCase, progress: Progress) -> list[SpeedRow]:
    if case.workload.kind == "compilation" and case.scenario is not None:
        return compilation.measure(case.scenario, label=case.label, worlds=case.worlds)
    return [_measure_rate(case, progress)]


def _measure_rate(case: WorkloadCase, progress: Progress) -> SpeedRow:
    workload, worlds, robots, repeats = case.workload, case.worlds, case.robots, case.repeats
    match workload.kind:
        case "generation":
            row = environments.measure(
                workload.source, robots=robots, worlds=worlds, repeats=repeats
            )
            return replace(row, device_peak_bytes=peak_device_bytes())
        case "clearance":
            return hull_clearance.measure(worlds=worlds, robots=robots, repeats=repeats)
        case "search":
            return graph_search.measure(repeats=repeats)
        case "dynamics":
            return free_motion.measure(vehicles=worlds, repeats=repeats, kernels=case.kernels)
        case "arm_dynamics":
            return arm_motion.measure(vehicles=worlds, repeats=repeats)
    if case.scenario is None:
        raise ConfigError(f"workload {case.label}: needs a scenario")
    if workload.kind == "preparation":
        return simulation.measure_preparation(
            case.scenario, label=case.label, worlds=worlds, repeats=repeats, progress=progress
        )
    if workload.kind == "recording":
        return recording.measure(
            case.scenario,
            label=case.label,
            worlds=worlds,
            repeats=repeats,
            folder=case.folder,
            progress=progress,
        )
    return simulation.measure(
        case.scenario,
        label=case.label,
        worlds=worlds,
        repeats=repeats,
        devices=case.devices,
        prepared=case.prepared,
        progress=progress,
    )


def _largest_that_fits(case: WorkloadCase, progress: Progress) -> int:
    """Largest half, quarter, eighth ... of the worlds that can be measured; 0 if not even one."""
    worlds = case.worlds // 2
    while worlds >= 1:
        try:
            progress.describe(f"out of device memory; trying {worlds} worlds")
            _measure_case(replace(case, worlds=worlds), progress)
        except jax.errors.JaxRuntimeError as error:
            if not devices.is_out_of_memory(error):
                raise
            worlds //= 2
        else:
            break
    return worlds


def _build_refused_row(case: WorkloadCase, reason: str, out_of_memory: bool) -> SpeedRow:
    scenario = case.scenario
    return SpeedRow(
        workload=case.label,
        inside="",
        worlds=case.worlds,
        robots=case.robots,
        unit="",
        median=None,
        low=None,
        high=None,
        repeats=0,
        compile_s=None,
        devices=case.devices,
        engine=scenario.engine if scenario else case.workload.engine,
        kernels=scenario.kernels if scenario else case.kernels,
        controller=case.controller,
        device_peak_bytes=peak_device_bytes(),
        refused=reason,
        out_of_memory=out_of_memory or "out of device memory" in reason,
    )
