"""Kernels of a simulator's programs, and none with xla, on what passes for a GPU."""

import jax
import pytest

from angler_kernels.cuda import nvrtc
from angler_kernels.cuda.nvrtc import CudaCompilerError
from angler_mjx.errors import RunError
from angler_mjx.runs.simulator import programs
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.editing import scenario_table, set_value
from angler_mjx.scenario.scenario import Scenario, load_scenario


@pytest.fixture(autouse=True)
def _on_what_passes_for_a_gpu(monkeypatch, compiled_sources):
    programs.clear_shared()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    yield
    programs.clear_shared()


def simulator(scenario, kernels, **edits):
    table = scenario_table(scenario)
    for key, value in {**edits, "engine": "fused", "kernels": kernels}.items():
        table = set_value(table, key, value)
    return Simulator(Scenario.model_validate({**table, "worlds": 2, "tile": 2}))


def primitives(jaxpr):
    """Yield the names of all operations, those inside of others too."""
    for eqn in jaxpr.eqns:
        yield eqn.primitive.name
        for value in eqn.params.values():
            for inner in value if isinstance(value, tuple | list) else [value]:
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from primitives(inner)


def kernels_of(program, *shapes):
    """Return the kinds of calls of kernels in a program."""
    found = set(primitives(jax.make_jaxpr(program)(*shapes).jaxpr))
    return found & {"cuda_block", "cuda_kernel"}


@pytest.mark.parametrize("planner", ["grid", "current"])
@pytest.mark.parametrize(
    ("kernels", "called"),
    [("xla", set()), ("cuda", {"cuda_block"})],
)
def test_preparation_and_planners(scenario, planner, kernels, called):
    made = simulator(scenario, kernels, **{"planner.name": planner}).programs
    assert kernels_of(made.prepare, *made._prepare_shapes()) == called


def test_tasks_in_flight():
    delivery = load_scenario("corridor_delivery")
    made = simulator(delivery, "cuda", **{"task.allocation": "nearest"}).programs
    fleet, worlds, policy = made._prepare_shapes()[0], made.batch_shape, made._setup.policy
    state = made.flight.reset.shape(fleet, worlds, *policy)
    cells = made.flight.pack_cells.shape(worlds)
    called = kernels_of(made.flight.segment, fleet, worlds, state, cells, *policy)
    assert called == {"cuda_block", "cuda_kernel"}


def test_a_kernel_that_does_not_compile_names_the_line_and_what_to_use(scenario, monkeypatch):
    """Of the engine or of a planner, ahead of time or in a call: one message."""
    made = simulator(scenario, "cuda").programs

    def refuse(source, architecture, folder):
        raise CudaCompilerError("NVRTC: kernel.cu(1): error: x")

    monkeypatch.setattr(nvrtc, "begin_compilation", refuse)
    message = r'^kernels = "cuda": NVRTC: kernel\.cu\(1\): error: x; or use kernels = "xla"'
    with pytest.raises(RunError, match=message):
        made.compile()
    with pytest.raises(RunError, match=message):
        made.prepare(*made._prepare_shapes())
