"""Executables on disk: loaded where everything is equal, compiled anew where anything is not."""

import os
import subprocess
import sys
import threading
import time
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring

from angler_experiments.ocean import headland
from angler_mjx.runs.simulator import compilation, compile_cache, programs, stored_programs
from angler_mjx.runs.simulator.compilation import CompiledFunction, ParallelCompiler
from angler_mjx.runs.simulator.devices import build_mesh
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

X = jnp.arange(3.0)
SINGLE = """
schema_version = 1
name = "single"
worlds = 1
tile = 1

[time]
horizon_s = 2.0
record_hz = 10.0

[world]
preset = "open"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_mix = { wu2018 = 1.0, von_benzon2022 = 2.0 }
"""


@pytest.fixture
def folder(tmp_path):
    """The folder of the compile cache; JAX keeps nothing there, executables are in `programs`."""
    with compile_cache.use_cache_folder(tmp_path):
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 1e9)
        programs.clear_shared()
        yield tmp_path
    programs.clear_shared()


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    """The cheapest scenario to compile: a robot in open water."""
    path = tmp_path_factory.mktemp("single") / "single.toml"
    path.write_text(SINGLE)
    return load_scenario(path)


@pytest.fixture(scope="module")
def in_current(tmp_path_factory):
    """The same in the current of a file."""
    folder = tmp_path_factory.mktemp("tide")
    headland.write_dataset(folder / "headland.nc")
    path = folder / "tide.toml"
    path.write_text(f'{SINGLE}\n[[world.currents]]\ntype = "grid"\nfile = "headland.nc"\n')
    return load_scenario(path)


@pytest.fixture
def setting():
    """Set the environment variable; the one of all tests is set again at the end."""
    before = os.environ[stored_programs.SETTING]

    def set_value(value):
        os.environ[stored_programs.SETTING] = value

    yield set_value
    os.environ[stored_programs.SETTING] = before


class Counted:
    """``scale * x**2`` and how often it was traced."""

    def __init__(self, scale=1.0):
        self.scale, self.traces = scale, 0

    def __call__(self, x):
        self.traces += 1
        return {"y": self.scale * x**2, "n": jnp.int32(x.size)}


def open_store(key=("key",)):
    return stored_programs.open_store(key, build_mesh(1))


def compile_ahead(x=X, name="square", store=None):
    """Return ``x**2`` compiled, and whether it was traced for that."""
    function = Counted()
    program = CompiledFunction(function, name=name, store=store or open_store())
    with ParallelCompiler(1) as compiler:
        pending = compiler.begin(program, x)
        shape = program.shape(x)
    executable, seconds = pending.result()
    assert seconds > 0
    assert shape["y"].shape == x.shape
    assert shape["n"].dtype == jnp.int32
    program.keep(executable)
    return program, function.traces > 0


def files(folder, kind="program"):
    return sorted((folder / "programs").glob(f"*.{kind}"))


def test_a_stored_program_is_not_traced_and_gives_the_same(folder):
    first, was_traced = compile_ahead()
    assert was_traced
    second, was_traced = compile_ahead()
    assert not was_traced
    for program in (first, second):
        result = program(X)
        np.testing.assert_array_equal(result["y"], [0.0, 1.0, 4.0])
        assert result["n"] == 3
    assert len(files(folder)) == 1


def test_a_function_that_is_called_first_is_stored_too(folder):
    for traces in (1, 0):
        function = Counted(2.0)
        program = CompiledFunction(function, name="called", store=open_store())
        np.testing.assert_array_equal(program(X)["y"], [0.0, 2.0, 8.0])
        assert function.traces == traces
    np.testing.assert_array_equal(program(jnp.ones(2))["y"], [2.0, 2.0])
    assert function.traces == 1
    np.testing.assert_array_equal(program(X)["y"], [0.0, 2.0, 8.0])
    assert function.traces == 1


def test_other_names_shapes_keys_and_flags_are_other_programs(folder):
    compile_ahead()
    assert compile_ahead(name="other")[1]
    assert compile_ahead(x=jnp.arange(4.0))[1]
    assert compile_ahead(x=jnp.arange(3))[1]
    assert compile_ahead(store=open_store(("key", 1)))[1]
    before = os.environ.get("XLA_FLAGS")
    os.environ["XLA_FLAGS"] = f"{before or ''} --xla_cpu_enable_fast_math=false"
    try:
        assert compile_ahead()[1]
    finally:
        os.environ.pop("XLA_FLAGS")
        if before is not None:
            os.environ["XLA_FLAGS"] = before
    assert not compile_ahead()[1]
    assert len(files(folder)) == 6
    # Programs of equal text share one.
    assert len(files(folder, "executable")) == 4


def test_large_constants_are_part_of_what_is_compared(folder):
    for i in range(2):
        table = np.arange(20_000.0, dtype=np.float32)
        table[17_000] = i
        program = CompiledFunction(
            lambda x, table=table: jnp.asarray(table)[x], name=str(i), store=open_store()
        )
        assert program(jnp.int32(17_000)) == i


def test_an_equal_program_of_another_key_is_not_compiled_again(folder):
    events = Counter()

    def listen(event, seconds, **_):
        events[event] += 1

    compile_ahead()
    monitoring.register_event_duration_secs_listener(listen)
    try:
        program, was_traced = compile_ahead(store=open_store(("key", "other")))
    finally:
        monitoring.unregister_event_duration_listener(listen)
    assert was_traced
    assert events["/jax/core/compile/backend_compile_duration"] == 0
    np.testing.assert_array_equal(program(X)["y"], [0.0, 1.0, 4.0])
    assert not compile_ahead(store=open_store(("key", "other")))[1]


def test_an_equal_program_with_other_unused_arguments_is_compiled_anew(folder):
    def double(used, unused):
        return 2 * used

    for length in (3, 4, 3):
        program = CompiledFunction(double, name="double", store=open_store(("key", length)))
        np.testing.assert_array_equal(program(X, jnp.ones(length)), 2 * X)
    assert len(files(folder, "executable")) == 2


def test_a_program_in_the_cache_of_jax_is_stored_all_the_same(folder):
    """XLA cannot serialise what it has read from there: its kernels would be missing."""
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.jit(Counted(), compiler_options=compilation.NO_AUTOTUNING).lower(X).compile()
    in_cache = sorted(folder.glob("*-cache"))
    assert in_cache
    assert compile_ahead()[1]
    program, was_traced = compile_ahead()
    assert not was_traced
    np.testing.assert_array_equal(program(X)["y"], [0.0, 1.0, 4.0])
    assert sorted(folder.glob("*-cache")) == in_cache
    assert jax.config.jax_enable_compilation_cache


@pytest.mark.parametrize("kind", ["program", "executable"])
@pytest.mark.parametrize("damage", [lambda x: x[: len(x) // 2], lambda x: b"", lambda x: x[::-1]])
def test_a_damaged_file_is_compiled_anew_and_replaced(folder, damage, kind):
    compile_ahead()
    (path,) = files(folder, kind)
    path.write_bytes(damage(path.read_bytes()))
    program, was_traced = compile_ahead()
    assert was_traced
    np.testing.assert_array_equal(program(X)["y"], [0.0, 1.0, 4.0])
    assert not compile_ahead()[1]


def test_a_program_that_the_device_refuses_is_compiled_anew(folder, monkeypatch, setting):
    setting("1")
    compile_ahead()

    def refuse(*_, **__):
        raise jax.errors.JaxRuntimeError("INTERNAL: no such target")

    monkeypatch.setattr(stored_programs.serialize_executable, "deserialize_and_load", refuse)
    program, was_traced = compile_ahead()
    assert was_traced
    np.testing.assert_array_equal(program(X)["y"], [0.0, 1.0, 4.0])
    called = CompiledFunction(Counted(), name="square", store=open_store())
    np.testing.assert_array_equal(called(X)["y"], [0.0, 1.0, 4.0])


def test_a_folder_that_cannot_be_written_stores_nothing(folder):
    (folder / "programs").write_text("not a folder")
    for _ in range(2):
        program, was_traced = compile_ahead()
        assert was_traced
        np.testing.assert_array_equal(program(X)["y"], [0.0, 1.0, 4.0])


def test_two_writers_at_once_leave_a_program(folder):
    threads = [threading.Thread(target=compile_ahead) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not compile_ahead()[1]
    assert len(list((folder / "programs").iterdir())) == 2


def test_keys_that_say_nothing_of_an_object_are_not_stored(folder):
    assert open_store(None) is None
    assert open_store((object(),)) is None
    assert open_store(("key",)) is not None


def test_only_commands_store_unless_a_caller_enables_it(folder, monkeypatch, setting):
    monkeypatch.setattr(stored_programs, "_enabled_by_command", False)
    for value, by_caller, by_command in (("", False, True), ("0", False, False), ("1", True, True)):
        setting(value)
        assert (open_store() is not None) == by_caller
        monkeypatch.setattr(stored_programs, "_enabled_by_command", True)
        assert (open_store() is not None) == by_command
        monkeypatch.setattr(stored_programs, "_enabled_by_command", False)
    setting("1")
    jax.config.update("jax_enable_compilation_cache", False)
    assert open_store() is None


def test_what_was_not_used_for_longest_is_removed(tmp_path):
    now = time.time()
    for name, age in (("old", 30), ("older", 40), ("new", 10), ("newer", 0)):
        path = tmp_path / name
        path.write_bytes(bytes(100))
        os.utime(path, (now - age, now - age))
    stored_programs.remove_unused(tmp_path, 250)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "newer"]


def test_use_is_noted(folder):
    compile_ahead()
    paths = files(folder) + files(folder, "executable")
    for path in paths:
        os.utime(path, (1.0, 1.0))
    compile_ahead()
    assert all(path.stat().st_mtime > 1e9 for path in paths)
    assert len(paths) == 2


def fly(scenario):
    """Fly from worlds to the end of a segment; return arrays and names of what was traced."""
    programs.clear_shared()
    traced = Counter()

    def listen(event, seconds, *, fun_name="", **_):
        if event == "/jax/core/compile/jaxpr_trace_duration":
            traced[fun_name] += 1

    monitoring.register_event_duration_secs_listener(listen)
    try:
        simulator = Simulator(scenario)
        simulator.compile()
        worlds = simulator.worlds(0)
        flown = simulator.segment(worlds, simulator.reset(worlds))
        return jax.device_get((worlds, flown)), traced
    finally:
        monitoring.unregister_event_duration_listener(listen)


@pytest.mark.parametrize("engine", ["mjx", "fused"])
def test_a_simulator_of_stored_programs_traces_none_and_flies_the_same(folder, single, engine):
    small = single.model_copy(update={"engine": engine})
    flown, traced = fly(small)
    assert {"sample_tile", "reset", "_run_segment"} <= set(traced)
    again, traced = fly(small)
    assert not {"sample_tile", "reset", "_run_segment"} & set(traced)
    for (path, leaf), other in zip(
        jax.tree.leaves_with_path(flown), jax.tree.leaves(again), strict=True
    ):
        np.testing.assert_array_equal(leaf, other, err_msg=jax.tree_util.keystr(path))


def test_programs_that_hold_fields_are_not_stored(folder, single, in_current):
    assert Simulator(single).programs.store is not None
    assert Simulator(in_current).programs.store is None


def test_only_another_simulation_has_another_key(folder, scenario):
    def key(**edits):
        return Simulator(scenario.model_copy(update={"tile": 2, **edits})).programs.store.key

    assert key() == key(name="other", seed=8, worlds=6)
    keys = {key(), key(goal_tolerance_m=0.31), key(tile=4), key(engine="fused")}
    assert len(keys) == 4
    with jax.enable_x64(True):
        assert key() not in keys


def test_the_platforms_that_a_command_allows_are_no_part_of_a_key():
    assert jax.config.jax_platforms in (None, "", "cpu")
    before, platforms = stored_programs.trace_settings(), jax.config.jax_platforms
    for other in (None, "cpu"):
        jax.config.update("jax_platforms", other)
        assert stored_programs.trace_settings() == before
    jax.config.update("jax_platforms", platforms)


def test_a_stored_program_factorises_in_a_process_that_lowered_none(folder):
    """JAX looks LAPACK up when it lowers; another process loads and runs, and lowers nothing."""
    code = """
import jax
import jax.numpy as jnp

from angler_mjx.runs.simulator import stored_programs
from angler_mjx.runs.simulator.compilation import CompiledFunction, ParallelCompiler
from angler_mjx.runs.simulator.devices import build_mesh

jax.config.update("jax_compilation_cache_dir", FOLDER)
store = stored_programs.open_store(("factor",), build_mesh(1))
program = CompiledFunction(jnp.linalg.cholesky, name="factor", store=store)
with ParallelCompiler(1) as compiler:
    program.keep(compiler.begin(program, jnp.eye(3) * 4.0).result()[0])
print(float(program(jnp.eye(3) * 4.0)[2, 2]))
"""
    code = code.replace("FOLDER", repr(str(folder)))
    environment = os.environ | {stored_programs.SETTING: "1"}
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        assert done.stdout.split()[-1] == "2.0"
    assert len(files(folder)) == 1
