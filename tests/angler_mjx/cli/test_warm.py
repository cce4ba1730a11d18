"""`angler warm`: the run that follows compiles none of the three programs again."""

import os
import subprocess
import sys

import pytest

from angler_mjx.runs.simulator import stored_programs

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
    """Output and log of a command that keeps its programs in ``tmp_path / "kept"``."""
    # A threshold above 0, as in the suite, would leave out what compiles fast.
    kept = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "kept"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_LOG_COMPILES": "1",
        stored_programs.SETTING: "",
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
    return done.stdout, done.stderr


def kept(tmp_path):
    """Stored programs in the cache."""
    return sorted(path.name for path in (tmp_path / "kept" / "programs").glob("*.program"))


@pytest.mark.nightly(by="test_stored_programs.py")
def test_a_run_after_it_traces_and_compiles_nothing_of_its_own(tmp_path):
    for name in ("small", "wide"):
        text = SCENARIO.replace('"small"', f'"{name}"').replace("[8, 8, 8]", f"[{len(name)}, 8, 8]")
        (tmp_path / f"{name}.toml").write_text(text)
    flags = ("--engine", "fused", "--device", "cpu")
    printed, log = angler(tmp_path, "warm", "small.toml", "wide.toml", *flags)
    assert "Finished tracing sample_tile" in log
    warmed = kept(tmp_path)
    assert len(warmed) == 2 * len(PROGRAMS)
    assert all(part in printed for part in (*PROGRAMS, "small", "wide", "fused"))
    assert printed.splitlines()[-1] == str(tmp_path / "kept")
    assert not (tmp_path / "runs").exists()
    for name in ("small", "wide"):
        _, log = angler(tmp_path, "rollout", f"{name}.toml", *flags, "--no-figures")
        assert (tmp_path / "runs" / name / "summary.json").exists()
        assert "Finished tracing" in log
        assert "tracing sample_tile" not in log
        assert "tracing _run_segment" not in log
    assert kept(tmp_path) == warmed
