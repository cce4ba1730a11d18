"""The check of a GPU: what it covers, how it compares, and one check of a CPU against itself."""

import ast
import json
import time
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from angler_mjx.planning.register import find, planner_names
from angler_mjx.scenario.policy_tables import POLICIES
from angler_mjx.scenario.scenario import shipped_scenarios
from angler_mjx.sim.engines.base import by_name
from angler_mjx.studies.speed.workloads import WORKLOADS, Engine, Kernels
from tools.gpu_check import __main__ as command
from tools.gpu_check import work, workloads
from tools.gpu_check.checks import CHECKS, RATES, list_checks
from tools.gpu_check.comparing import ErrorBound, compare_arrays
from tools.gpu_check.running import CheckOutcome, judge_tests

ROOT = Path(__file__).parents[2]
LAUNCHERS = ("angler_kernels.programs.BlockProgram", "angler_mjx.sim.engines.cuda.launch")
"""Names by which modules launch kernels of their own."""
MEASURED = {"angler_mjx.studies.speed.roofline"}
"""Kernels without an outcome: the first of all rates, in every workload of `angler bench`."""


def covered(kind):
    found = {name for check in CHECKS.values() for name in check.covers}
    return {name.partition(":")[2] for name in found if name.startswith(f"{kind}:")}


def built_in_device_planners():
    modules = {name: find(name).module for name in planner_names()}
    ours = {name: module for name, module in modules.items() if module.startswith("angler_mjx.")}
    return [name for name, module in ours.items() if ".host." not in module]


def launching():
    """Modules that import what launches kernels."""
    for folder, package in (("kernels", "angler_kernels"), (".", "angler_mjx")):
        for file in sorted((ROOT / folder / package).rglob("*.py")):
            module = ".".join(file.relative_to(ROOT / folder).with_suffix("").parts)
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.ImportFrom):
                    imported = {f"{node.module}.{alias.name}" for alias in node.names}
                    if imported & set(LAUNCHERS):
                        yield module


def test_every_engine_is_checked():
    every = {type(by_name(e, k)) for e in get_args(Engine.__value__) for k in kernels()}
    checked = {type(by_name(*name.split("/"))) for name in covered("engine")}
    assert checked == every


def kernels():
    return get_args(Kernels.__value__)


def test_every_kernel_is_checked():
    modules = set(launching()) - MEASURED
    assert {"angler_kernels.matching", "angler_mjx.sim.engines.dynamics"} <= modules
    assert not [m for m in modules if not any(m.startswith(name) for name in covered("kernel"))]


@pytest.mark.parametrize(
    ("kind", "every"),
    [
        ("planner", set(built_in_device_planners())),
        # What robots carry together is planned before the start.
        ("replanning", set(built_in_device_planners()) - {"carry"}),
        ("policy", set(POLICIES)),
        ("scenario", set(shipped_scenarios())),
        ("workload", set(WORKLOADS)),
    ],
)
def test_every_name_is_checked(kind, every):
    assert covered(kind) == every


def test_every_rate_is_measured_once_and_last():
    assert sorted(list_checks()[-len(RATES) :]) == sorted(f"rate/{name}" for name in WORKLOADS)
    assert len(set(list_checks())) == len(list_checks())


def test_arrays_are_compared_within_their_bounds():
    ours = {"p": np.array([[0.0, 1.0], [np.nan, 2.0], [3.0, 3.0]]), "n": np.array([1, 2, 3])}
    assert compare_arrays(ours, ours, {}) == ([], [])
    moved = {**ours, "p": ours["p"] + np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.5]])}
    (fault,), notes = compare_arrays(moved, ours, {})
    assert "p: 0.6667 of 3 rows within 0, 1 must be; first at (2,)" in fault
    assert not notes
    assert compare_arrays(moved, ours, {"p": ErrorBound(atol=0.6)}) == ([], [])
    faults, (note,) = compare_arrays(moved, ours, {"p": ErrorBound(fraction=0.6)})
    assert not faults
    assert "largest difference 0.5" in note
    assert compare_arrays(moved, ours, {"p": ErrorBound(fraction=0.7)})[0]
    infinite = {**ours, "p": np.where(np.isnan(ours["p"]), 0.0, ours["p"])}
    assert compare_arrays(infinite, ours, {"p": ErrorBound(atol=1e9)})[0]
    assert (
        "shape (2,), on the CPU (3,)"
        in compare_arrays({**ours, "n": ours["n"][:2]}, ours, {})[0][0]
    )
    assert "arrays differ: ['n']" in compare_arrays({"p": ours["p"]}, ours, {})[0][0]
    assert compare_arrays({"p": np.zeros(0)}, {"p": np.zeros(0)}, {})[0]


def test_rows_are_compared_only_where_another_array_agrees():
    """Of three robots the first has another plan; a fault of the second alone is one of two."""
    cpu = {"plan_m": np.zeros((1, 3, 2)), "early_m": np.zeros((1, 3, 2))}
    moved = {name: array.copy() for name, array in cpu.items()}
    moved["plan_m"][0, 0] = 5.0
    moved["early_m"][0, 0] = 7.0
    bounds = {
        "plan_m": ErrorBound(fraction=0.5, axes=2),
        "early_m": ErrorBound(atol=0.1, axes=2, equal="plan_m"),
    }
    faults, (note,) = compare_arrays(moved, cpu, bounds)
    assert not faults
    assert note.startswith("plan_m: 0.6667 of 3 rows")
    moved["early_m"][0, 1] = 1.0
    (fault,), _ = compare_arrays(moved, cpu, bounds)
    assert fault.startswith("early_m: 0.5000 of 2 rows within 0.1, 1 must be; first at (0,)")


@pytest.mark.parametrize(("ratio", "faults"), [(1.019, 0), (0.981, 0), (1.021, 1), (np.inf, 1)])
def test_durations_may_differ_by_a_fraction_of_the_cpus(ratio, faults):
    cpu = {"plan_s": np.array([[50.0, 0.0, np.inf]])}
    ours = {"plan_s": np.array([[50.0 * ratio, 0.0, np.inf]])}
    assert len(compare_arrays(ours, cpu, {"plan_s": ErrorBound(rtol=0.02, axes=2)})[0]) == faults


ROW = {"median": 89.0, "worlds": 4, "robots": 1, "unit": "steps/s"}
STORED = {**ROW, "median": 100.0, "date": "2026-01-02", "commit": "abc"}
SECONDS = {**ROW, "median": 20.0, "unit": "s", "processor": "A", "cpu_count": 16}
COMPILED = {**STORED, **SECONDS, "median": 18.1}


@pytest.mark.parametrize(
    ("row", "stored", "status"),
    [
        (ROW, STORED, "slower"),
        ({**ROW, "median": 91.0}, STORED, "passed"),
        ({**ROW, "median": 200.0}, STORED, "passed"),
        (ROW, None, "skipped"),
        (ROW, {**STORED, "worlds": 8}, "skipped"),
        (SECONDS, COMPILED, "passed"),
        (SECONDS, {**COMPILED, "median": 17.9}, "slower"),
        ({**SECONDS, "median": 1.0}, COMPILED, "passed"),
        (SECONDS, {**COMPILED, "processor": "B"}, "skipped"),
        (SECONDS, {**COMPILED, "cpu_count": 2}, "skipped"),
    ],
)
def test_a_rate_is_judged_by_the_stored_median(row, stored, status):
    judged, reason = workloads.judge_rate(row, stored)
    assert judged == status
    rate = f"{row['median']:.1f} s" if row["unit"] == "s" else f"{row['median']:.3e} steps/s"
    assert reason.startswith(rate)


def test_medians_are_stored_by_card_beside_others(tmp_path):
    path = tmp_path / "medians.json"
    assert workloads.read_medians("A", path) == {}
    workloads.write_medians("A", {"dynamics": STORED}, path)
    workloads.write_medians("B", {"dynamics": {**STORED, "median": 7.0}}, path)
    workloads.write_medians("A", {"mjx": STORED}, path)
    assert set(workloads.read_medians("A", path)) == {"dynamics", "mjx"}
    assert workloads.read_medians("B", path)["dynamics"]["median"] == 7.0


ABOUT = {
    "commit": "abc",
    "device": "cpu",
    "driver": None,
    "versions": {"jax": "0"},
    "cpu_count": 2,
}


@pytest.fixture
def on_cpu(tmp_path, monkeypatch):
    """Run chosen checks of a CPU whose description is known; their results file."""
    monkeypatch.setattr(command, "_describe_device", lambda machine: ABOUT)
    results = tmp_path / "results.jsonl"

    def run(*only, **options):
        chosen = {"device": "cpu", "jobs": 2, "results": results, "only": only, **options}
        return command.main(command.GpuCheckOptions(**chosen)), results

    return run


def test_a_check_is_run_compared_and_not_run_again(on_cpu, capsys):
    name = "kernel/angler_kernels.matching"
    status, results = on_cpu(name)
    assert status == 0
    (line,) = map(json.loads, results.read_text().splitlines())
    assert (line["name"], line["status"], line["reason"]) == (name, "passed", "")
    assert "gpu-check: 1 passed, 0 failed, 0 slower, 0 skipped, 0 unfinished" in (
        capsys.readouterr().out
    )
    begun = time.monotonic()
    assert on_cpu(name)[0] == 0
    assert len(results.read_text().splitlines()) == 1
    assert time.monotonic() - begun < 1.0


def test_what_time_did_not_suffice_for_is_left_to_the_next_call(on_cpu, capsys):
    status, results = on_cpu("kernel/", "rate/", minutes=0.0)
    assert status == 3
    assert not results.exists()
    assert "unfinished rate/dynamics: not begun" in capsys.readouterr().out


def test_outcomes_of_another_commit_are_not_believed(on_cpu, capsys, monkeypatch):
    name = "kernel/angler_kernels.matching"
    outcome = CheckOutcome(name=name, status="failed", seconds=1.0, reason="of old")
    _, results = on_cpu(name, minutes=0.0)
    for commit, status in (("other", 3), ("abc", 1)):
        line = {**outcome.__dict__, "mark": [commit, "cpu", "cpu"], "at_utc": "now"}
        with results.open("a") as file:
            file.write(json.dumps(line) + "\n")
        assert on_cpu(name, minutes=0.0)[0] == status
    assert "failed     kernel/angler_kernels.matching: of old" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("code", "last", "status", "reason"),
    [
        (0, "1 passed, 146 deselected in 9.10s", "passed", "1 passed, 146 deselected in 9.10s"),
        (0, "1 skipped, 146 deselected in 2.80s", "skipped", "1 skipped"),
        (1, "1 failed, 146 deselected in 2.80s", "failed", "ModuleNotFoundError: no trimesh"),
    ],
)
def test_failed_tests_say_why(code, last, status, reason):
    text = f"FAILED tests/a.py::test_b - ModuleNotFoundError: no trimesh\n{last}"
    judged, judged_reason = judge_tests(code, text)
    assert judged == status
    assert reason in judged_reason
    assert last in judged_reason


def test_a_machine_without_a_needed_module_is_refused_before_the_first_check(tmp_path, monkeypatch):
    monkeypatch.setattr(work, "NEEDED", ("json", "no_such_module"))
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        work.main("about", tmp_path / "about.json")
    assert not (tmp_path / "about.json").exists()


def test_a_name_that_no_check_has_is_refused(on_cpu, capsys):
    assert on_cpu("kernal/")[0] == 2
    assert "--only kernal/: no check begins so" in capsys.readouterr().err
