"""A few wrong inputs for every reader in every run of the tests; `make fuzz` feeds many."""

import ast
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .readers import READERS, ROOT, try_one
from .run import input_of

FEW = settings(
    max_examples=40,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.mark.parametrize("name", sorted(READERS))
def test_valid_inputs_are_read(name, tmp_path):
    reader = READERS[name]
    allowed, path = reader.allowed, tmp_path / f"input{reader.end}"
    for data in reader.inputs:
        path.write_bytes(data)
        try:
            reader.read(path)
        except allowed as error:
            pytest.fail(f"{name}: {error}")


@pytest.mark.parametrize("name", sorted(READERS))
@FEW
@given(number=st.integers(0, 2**32))
def test_near_valid_inputs_end_in_our_own_errors(name, tmp_path, number):
    reader = READERS[name]
    try_one(reader, input_of(reader, "tests", number), tmp_path / f"input{reader.end}")


@pytest.mark.parametrize("name", sorted(READERS))
@FEW
@given(data=st.binary(max_size=300))
def test_bytes_from_nowhere_end_in_our_own_errors(name, tmp_path, data):
    try_one(READERS[name], data, tmp_path / f"input{READERS[name].end}")


FORBIDDEN = {"pickle", "marshal", "shelve", "dill", "joblib", "cloudpickle"}
PACKAGES = ("angler_mjx", "kernels", "sitl_bridge", "experiments")
WIRE = {
    f"angler_mjx/planning/host/{name}.py:pickle"
    for name in (
        "worker",
        "pool",
        "cluster/ray_workers",
    )
}
"""Between this process and those that it starts, through pipes that nobody else has an end of; and
the actors of a Ray cluster that a person named, which runs their code anyway."""


CACHE = {"angler_mjx/runs/simulator/stored_programs.py:pickle"}
"""The user's own cache of machine code, which JAX unpickles too; it is no input of anybody."""

USER_CLASSES = {f"angler_mjx/user_classes.py:{name}" for name in ("compile", "exec")}
"""The Python file of a planner or control law that a person named to be run."""


def test_no_code_is_made_from_what_is_read():
    """No pickle, no eval: in all code of the project, by its syntax tree."""
    found = []
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name.partition(".")[0] for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [(node.module or "").partition(".")[0]]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                names = [node.func.id] if node.func.id in ("eval", "exec", "compile") else []
            elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                names = [] if ast.unparse(node.value) == "False" else ["pickle"]
            bad = FORBIDDEN | {"eval", "exec", "compile"}
            found += [f"{path.relative_to(ROOT)}:{name}" for name in names if name in bad]
    assert set(found) == WIRE | CACHE | USER_CLASSES


def test_the_corpus_is_there():
    assert Path(ROOT / "benchmarks" / "results.jsonl").exists()
    assert all(reader.inputs for reader in READERS.values())
