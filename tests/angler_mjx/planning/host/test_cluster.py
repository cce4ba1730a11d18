"""What of planning on a cluster needs no cluster."""

import importlib.util
import pickle
import subprocess
import sys

import pytest

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.planning import register
from angler_mjx.planning.host.cluster import connection
from angler_mjx.planning.host.cluster.ray_workers import RayWorkers, _error_line
from angler_mjx.planning.register import PlannerSpec

TEXT = "class Still:\n    def plan(self, problem):\n        return []\n"


@pytest.fixture
def spec(tmp_path):
    file = tmp_path / "still.py"
    file.write_text(TEXT)
    return PlannerSpec(reference=register.find(f"{file}:Still"), max_points=5)


def test_a_planner_of_a_file_is_made_where_the_file_is_not(spec):
    sent = pickle.dumps(spec)
    spec.reference.file.unlink()
    there = pickle.loads(sent)
    assert (there.settings, there.max_points) == ({}, 5)
    assert there.make().plan(None) == []


def test_other_versions_are_told_by_name():
    here = connection.installed_versions()
    assert connection.format_differences(here, here) == ""
    there = {**here, "numpy": "1.0"}
    assert connection.format_differences(there, here) == f"numpy 1.0 there, {here['numpy']} here"


def test_an_edited_checkout_is_another_version(tmp_path, monkeypatch):
    monkeypatch.setattr(connection, "PACKAGE_FOLDER", tmp_path)
    before = connection.installed_versions()["angler_mjx"]
    assert connection.installed_versions()["angler_mjx"] == before
    (tmp_path / "more.py").write_text("x = 1\n")
    assert connection.installed_versions()["angler_mjx"] != before


def test_the_line_of_a_long_text_that_says_how_an_actor_died():
    assert _error_line(OSError("The actor died.\n\tpid: 3\nSome causes: ...")) == "The actor died."
    thrown = "task failed\nTraceback (most recent call last):\n  File\nValueError: no reef"
    assert _error_line(OSError(thrown)) == "ValueError: no reef"
    assert _error_line(OSError()) == "OSError"


def test_there_is_at_least_one_actor():
    with pytest.raises(ConfigError, match="at least 1"):
        RayWorkers("127.0.0.1:6379", 0)


WITHOUT = """
import sys
from importlib.abc import MetaPathFinder

class Hidden(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "ray":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hidden())
"""


def test_without_ray_its_extra_is_named(monkeypatch):
    if importlib.util.find_spec("ray") is None:
        with pytest.raises(UnsupportedError, match=r"install 'angler-mjx\[ray\]'"):
            RayWorkers("127.0.0.1:6379")
        return
    made = "from angler_mjx.planning.host.cluster.ray_workers import RayWorkers; RayWorkers('h:1')"
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT + made], capture_output=True, text=True, check=False
    )
    assert "UnsupportedError: planning on a cluster needs ray: pip install 'angler-mjx[ray]'" in (
        done.stderr
    )
