"""Cards that the plan command writes, and finds again."""

from types import SimpleNamespace

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import entering, problem_sets, submission
from angler_mjx.studies.speed.measured import graph_search


@pytest.fixture
def card():
    return {
        "schema_version": 1,
        "benchmark": problem_sets.load_benchmark().title,
        "name": "grid",
        "authors": [],
        "description": "planner",
        "kind": "plans",
        "machine": "A Core",
        "sets": ["open-still-known-01"],
    }


def test_a_card_has_the_factor_of_its_machine_and_keeps_it(tmp_path, monkeypatch, card):
    factors = iter([1.2345, 9.0])
    monkeypatch.setattr(graph_search, "measure_time_factor", lambda: next(factors))
    path = tmp_path / "card.toml"
    for _ in range(2):
        assert entering._write_card(path, card, {"name": "RRTConnect"}) == pytest.approx(
            1.234, abs=1e-3
        )
    assert submission.read_card(tmp_path).machine_factor == pytest.approx(1.234, abs=1e-3)
    with pytest.raises(ConfigError, match=r"another submission \(name, sets would differ\)"):
        entering._write_card(path, card | {"name": "b", "sets": []}, {"name": "RRTConnect"})


def test_planners_on_an_accelerator_are_named_and_not_scaled(tmp_path, monkeypatch, card):
    monkeypatch.setattr(graph_search, "measure_time_factor", lambda: 2.0)
    monkeypatch.setattr(entering.jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(entering.jax, "devices", lambda: [SimpleNamespace(device_kind="A Card")])
    monkeypatch.setattr(entering, "processor_name", lambda: "A Core")
    machines = [entering._name_machine({"name": name}) for name in ("priority", "RRTConnect")]
    assert machines == ["A Card", "A Core"]
    factors = [
        entering._write_card(tmp_path / f"{name}.toml", card, {"name": name})
        for name in ("priority", "RRTConnect")
    ]
    assert factors == [1.0, 2.0]
