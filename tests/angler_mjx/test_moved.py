"""Import paths of 0.1 lead to the modules of today."""

import importlib
import pickle
import subprocess
import sys
import warnings

import pytest

from angler_mjx._moved import MOVED, RENAMED, moved

PRINTED = {
    "angler_mjx.datasets": ("open", "Dataset"),
    "angler_mjx.datasets.loaders.torch": (),
    "angler_mjx.planning.host.ray_workers": ("RayWorkers",),
    "angler_mjx.session.batch": ("BatchSession",),
    "angler_mjx.session.flying": ("fly",),
    "angler_mjx.session.online": ("problem_of",),
    "angler_mjx.simulator.simulator": ("Simulator",),
}
"""Modules that README and docs of 0.1 imported from, and names."""


@pytest.fixture(autouse=True)
def _unseen():
    for name in [name for name in sys.modules if moved(name)]:
        del sys.modules[name]


@pytest.mark.parametrize("name", sorted(MOVED))
def test_a_package_is_the_one_of_today_and_a_warning_names_it(name):
    today = importlib.import_module(MOVED[name])
    spec = today.__spec__
    with pytest.warns(DeprecationWarning, match=f"^{name} is {MOVED[name]} since 0.2") as caught:
        assert importlib.import_module(name) is today
    own = [warning for warning in caught if str(warning.message).startswith(f"{name} is ")]
    assert [warning.filename for warning in own] == [importlib.__file__]
    assert today.__spec__ is spec
    assert today.__name__ == MOVED[name]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", sorted(PRINTED))
def test_names_that_docs_printed_are_those_of_today(name):
    if name.endswith("torch"):
        pytest.importorskip("torch")
    before = importlib.import_module(name)
    today = importlib.import_module(moved(name))
    for one in PRINTED[name]:
        assert getattr(before, one) is getattr(today, one)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_what_was_pickled_by_its_path_of_before_is_read():
    from angler_mjx.runs.storage.read_errors import wrap_read_errors

    text = pickle.dumps(wrap_read_errors, protocol=0)
    before = text.replace(b"angler_mjx.runs.storage", b"angler_mjx.storage")
    assert before != text
    assert pickle.loads(before) is wrap_read_errors


def test_a_module_that_never_was_is_not_found():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        with pytest.raises(ModuleNotFoundError, match=r"angler_mjx\.robot\.control\.nothing"):
            importlib.import_module("angler_mjx.control.nothing")
    with pytest.raises(ModuleNotFoundError, match=r"angler_mjx\.nothing"):
        importlib.import_module("angler_mjx.nothing")


def test_a_script_of_before_runs_and_is_warned_at_its_line(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("from angler_mjx import datasets\nprint(datasets.__name__)\n")
    done = subprocess.run(
        [sys.executable, "-W", "always::DeprecationWarning:__main__", script],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "angler_mjx.learning.datasets\n"
    assert f"{script}:1: DeprecationWarning: angler_mjx.datasets is" in done.stderr


@pytest.mark.parametrize("name", [f"{a}:{b}" for a, names in RENAMED.items() for b in names])
def test_a_renamed_class_is_found_by_its_name_of_before(name):
    path, before = name.split(":")
    module, today = importlib.import_module(path), RENAMED[path][before]
    with pytest.warns(DeprecationWarning, match=f"{path}.{before} is {today} since 0.2") as caught:
        assert getattr(module, before) is getattr(module, today)
    assert caught[0].filename == __file__
    with pytest.raises(AttributeError, match="has no attribute 'Knowledge'"):
        module.Knowledge  # noqa: B018


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_policy_of_before_imports_what_its_page_printed():
    from angler_mjx.sim.knowledge import Knows

    from angler_mjx.sim.policy import Known

    assert (Knows.__name__, Known.__name__) == ("Information", "PolicyInput")
