"""Runs of one folder: the programs of the next ones are compiled while one flies."""

import threading

from angler_mjx.progress import Progress
from angler_mjx.runs import multi_run, rollout
from angler_mjx.runs.processes import OneProcess
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import folder
from angler_mjx.scenario.scenario import load_scenario


def test_the_next_run_is_compiled_while_one_flies(tmp_path, monkeypatch):
    times = {"horizon_s": 0.5, "record_hz": 0.0}
    scenario = load_scenario("open_water_current", worlds=2, engine="fused", time=times)
    parts = [(f"run_{tile}", scenario.model_copy(update={"tile": tile})) for tile in (2, 1)]
    compiled = {tile: threading.Event() for tile in (2, 1)}
    compile_ahead, fly = Simulator.compile_ahead, rollout.rollout

    def record_compilation(simulator):
        compile_ahead(simulator)
        compiled[simulator.tile].set()

    def fly_after_compilation(scenario, **options):
        assert compiled[1].wait(timeout=120.0)
        return fly(scenario, **options)

    monkeypatch.setattr(Simulator, "compile_ahead", record_compilation)
    monkeypatch.setattr(rollout, "rollout", fly_after_compilation)
    assert multi_run.fly_runs(parts, tmp_path, Progress(), OneProcess(), {})
    for path, _ in parts:
        assert folder.Run(tmp_path / path).summary["timing"]["compile_s"] > 0.0
