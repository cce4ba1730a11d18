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


def test_groups_are_whole_if_all_their_runs_are(tmp_path, monkeypatch):
    plans = {"b": tmp_path / "b.zarr"}
    groups = [
        multi_run.RunGroup(building=tmp_path, parts=tuple((name, None) for name in names), plans={})
        for names in ("a", "cd")
    ]
    groups.insert(1, multi_run.RunGroup(building=tmp_path, parts=(("b", None),), plans=plans))
    flown, whole, counts = [], {"a": True, "b": False, "c": True}, []

    def fly_runs(parts, building, progress, processes, options, plans):
        assert building == tmp_path
        flown.append(([path for path, _ in parts], plans))
        return whole[parts[0][0]]

    class Counted(Progress):
        def start(self, total, done=0, unit="worlds"):
            counts.append((total, unit))

        def advance(self, amount, vehicle_steps=0):
            counts.append(amount)

    monkeypatch.setattr(multi_run, "fly_runs", fly_runs)
    assert not multi_run.fly_groups(groups, Counted(), 1)
    assert flown == [(["a"], {}), (["b"], plans), (["c", "d"], {})]
    assert counts == [(4, "runs"), 1, 1, 2]
    whole["b"] = True
    assert multi_run.fly_groups(groups, Progress(), 1)
