"""`angler warm`: the run that follows compiles none of the three programs again."""

import os
import subprocess
import sys

import pytest

SCENARIO = """
schema_version = 1
name = "small"
worlds = 2

[time]
horizon_s = 2.0
physics_dt_s = 0.01
control_dt_s = 0.05
record_hz = 5.0

[world]
preset = "open"
shape = [8, 8, 8]

[[fleet]]
vehicle = "bluerov2"
parameter_set = "blue_gazebo"
count = 1
cruise_speed_mps = 3.0
"""
PROGRAMS = ("prepare", "reset", "segment")


def angler(tmp_path, *arguments):
    """Output of a command that keeps its programs in ``tmp_path / "kept"``."""
    # A threshold above 0, as in the suite, would leave out what compiles fast.
    kept = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "kept"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    done = subprocess.run(
        [sys.executable, "-m", "angler_mjx.cli.main", *arguments],
        cwd=tmp_path,
        env=os.environ | kept,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def kept(tmp_path):
    """Programs of the simulator in the cache."""
    names = [path.name for path in (tmp_path / "kept").glob("*-cache")]
    return sorted(name for name in names if any(part in name for part in PROGRAMS))


@pytest.mark.nightly(by="test_compiling.py")
def test_a_run_after_it_compiles_nothing_of_its_own(tmp_path):
    (tmp_path / "small.toml").write_text(SCENARIO)
    told = angler(tmp_path, "warm", "small.toml", "--engine", "fused", "--device", "cpu")
    warmed = kept(tmp_path)
    assert len(warmed) == len(PROGRAMS)
    assert all(part in told for part in (*PROGRAMS, "small", "fused", str(tmp_path / "kept")))
    assert not (tmp_path / "runs").exists()
    angler(
        tmp_path, "rollout", "small.toml", "--engine", "fused", "--device", "cpu", "--no-figures"
    )
    assert (tmp_path / "runs" / "small" / "summary.json").exists()
    assert kept(tmp_path) == warmed
