"""The fixture that records: what it refuses, what it keeps, across processes."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from .deviations import Deviation

TESTS = Path(__file__).parent
INF, NAN = float("inf"), float("nan")


@pytest.fixture
def recorded():
    found = []
    return Deviation("a test", found), found


@pytest.mark.parametrize("value", [0.2, [0.0, 0.2], NAN, [0.0, NAN], INF])
def test_what_exceeds_its_bound_fails_and_is_recorded(recorded, value):
    deviation, found = recorded
    with pytest.raises(AssertionError, match="a key"):
        deviation("a key", value, 0.1)
    assert len(found) == 1


def test_nothing_compared_is_a_fault(recorded):
    with pytest.raises(AssertionError, match="nothing was compared"):
        recorded[0]("a key", [], 0.1)


@pytest.mark.parametrize(("rtol", "atol"), [(1e-3, 1e-6), (0.0, 1e-6), (1e-3, 0.0), (1e-6, 1e-3)])
def test_close_asks_what_numpy_asks(recorded, rtol, atol):
    """On both sides of the limit, for numbers of all sizes."""
    deviation, _ = recorded
    for theirs in (0.0, 1e-9, 1.0, -300.0):
        for share in (0.99, 1.01):
            ours = theirs + share * (atol + rtol * abs(theirs))
            if ours == theirs:
                continue
            passes = bool(np.isclose(ours, theirs, rtol=rtol, atol=atol))
            assert passes == (share < 1)
            if passes:
                deviation.close("a key", [ours], [theirs], rtol=rtol, atol=atol)
            else:
                with pytest.raises(AssertionError):
                    deviation.close("a key", [ours], [theirs], rtol=rtol, atol=atol)


def test_shapes_must_agree(recorded):
    with pytest.raises(AssertionError, match="a key"):
        recorded[0].close("a key", np.zeros((2, 3)), np.zeros(3), atol=1.0)
    recorded[0].close("a key", np.zeros((2, 3)), 0.0, atol=1.0)


def test_marks_are_near_to_themselves_alone(recorded):
    deviation, _ = recorded
    deviation.close("a key", [INF, 1.0], [INF, 1.0], atol=0.1)
    deviation.close("a key", [NAN, 1.0], [NAN, 1.0], atol=0.1, marks=True)
    for ours, theirs, marks in (
        (NAN, NAN, False),
        (NAN, 1.0, True),
        (1.0, NAN, True),
        (INF, 1.0, True),
        (INF, -INF, True),
    ):
        with pytest.raises(AssertionError):
            deviation.close("a key", [ours], [theirs], atol=0.1, marks=marks)


@pytest.mark.nightly(by="make test, which runs two")
def test_what_two_processes_found_comes_into_one_file(tmp_path):
    (tmp_path / "conftest.py").write_text(
        (TESTS / "conftest.py").read_text().replace("from . import", "import")
    )
    for name in ("deviations.py", "compile_times.py"):
        (tmp_path / name).write_text((TESTS / name).read_text())
    (tmp_path / "test_a.py").write_text("def test_a(deviation):\n    deviation('k', 0.2, 1.0)\n")
    (tmp_path / "test_b.py").write_text(
        "def test_b(deviation):\n"
        "    deviation('k', 0.3, 1.0)\n"
        "    deviation('n', float('nan'), 1.0)\n"
    )
    out = tmp_path / "found" / "deviations.json"
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, "--rootdir", ".", "--deviations", str(out), "."],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    held = json.loads(out.read_text())
    assert held["about"]["exit_status"] == 1
    by_key = {one["key"]: one for one in held["deviations"]}
    assert by_key["k"]["value"] == 0.3
    assert len(by_key["k"]["tests"]) == 2
    assert by_key["n"]["value"] == "nan"
