"""The `angler` command as a person meets it: help at once, one message for a fault, exit code 2."""

import os
import subprocess
import sys

import pytest

import angler_mjx
from angler_mjx.cli.main import COMMANDS, GROUPS, main
from angler_mjx.scenario.scenario import shipped_scenarios


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "angler_mjx.cli.main", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_help_loads_no_jax():
    script = (
        "import sys\n"
        "from angler_mjx.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'jax', 'mujoco', 'matplotlib', 'pyarrow', 'zarr'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


WORDS = [name for name in COMMANDS if name not in GROUPS] + [
    f"{group} {name}" for group, commands in GROUPS.items() for name in commands
]


@pytest.mark.parametrize("command", WORDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as left:
        main([*command.split(), "--help"])
    assert left.value.code == 0
    assert "usage: angler " + command in capsys.readouterr().out.replace("\n", " ")


FAULTS = {
    "unknown scenario": (["rollout", "no_such_scenario"], "no_such_scenario"),
    "zero worlds": (["rollout", "reef_fleet", "--worlds", "0"], "worlds"),
    "unknown vehicle": (["vehicle", "show", "bluerov9"], "bluerov9"),
    "not a run folder": (["figures", "."], "not a run folder"),
    "too many devices": (["rollout", "open_water_current", "--devices", "99"], "--devices 99"),
    "no devices": (["rollout", "open_water_current", "--devices", "0"], "--devices 0"),
    "flag of no scenario's": (["rollout", "reef_fleet", "--record-hz", "3"], "--record-hz: time"),
    "worlds without end": (["rollout", "reef_fleet", "--worlds", "9" * 30], "--worlds = 9999"),
    "no picture": (["env", "show", "none.zarr", "--out", "x.xyz"], "--out x.xyz"),
    "index without end": (
        ["export", ".", "--mcap", "x.mcap", "--worlds", "9" * 20],
        "no run holds so many",
    ),
    "too many to draw": (["env", "make", "--out", "x.zarr", "--count", "9" * 20], "--count 9999"),
    "scenario of control characters": (["rollout", "a\x1b[2J.toml"], r"a\x1b[2J.toml"),
    "value without end": (["rollout", "x" * 10_000], "xxx..."),
    "half of a shared run": (["rollout", "reef_fleet", "--processes", "2"], "--distributed"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_one_message_and_exit_code_2(fault, capsys):
    arguments, word = FAULTS[fault]
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("angler:") == 1
    assert word in shown.err
    assert "\x1b" not in shown.err
    assert len(shown.err) < 1000


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_has_read_enough_is_no_fault(unbuffered):
    """Whether the pipe breaks while it is written to, or when all that waited is written."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "angler_mjx.cli.main", "--help"],
        stdout=writer,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        timeout=60,
        check=False,
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, b"")


def test_version_is_that_of_the_package(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"angler {angler_mjx.__version__}\n"


def test_a_scenario_can_be_printed_and_used(capsys, tmp_path):
    main(["scenarios", "show", "reef_fleet"])
    text = capsys.readouterr().out
    assert text == shipped_scenarios()["reef_fleet"].read_text()
    (tmp_path / "mine.toml").write_text(text)
    main(["scenarios", "show", str(tmp_path / "mine.toml")])
    assert capsys.readouterr().out == text


def test_scenarios_alone_lists_them(capsys):
    main(["scenarios"])
    listed = capsys.readouterr().out
    assert all(name in listed for name in shipped_scenarios())


def test_public_names_are_in_dir():
    assert set(angler_mjx.__all__) <= set(dir(angler_mjx))
    assert len(angler_mjx.__all__) == 25


CACHE = """
import jax, sys
jax.jit(lambda x: x + 1)(1.0)  # JAX has looked at its settings by now
from angler_mjx.runs.simulator import compile_cache
compile_cache.enable_cache()
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: 3 * x + 1)(1.0)
"""


@pytest.mark.parametrize(
    ("given", "folder"),
    [
        ({}, "home/angler-mjx/xla"),
        ({"ANGLER_COMPILE_CACHE": "0"}, None),
        ({"JAX_COMPILATION_CACHE_DIR": "{}/mine"}, "mine"),
    ],
)
def test_python_keeps_programs_unless_told_otherwise(given, folder, tmp_path):
    names = ("JAX_COMPILATION_CACHE_DIR", "ANGLER_COMPILE_CACHE")
    kept = {name: value for name, value in os.environ.items() if name not in names}
    own = {name: value.format(tmp_path) for name, value in given.items()}
    subprocess.run(
        [sys.executable, "-c", CACHE],
        env={**kept, "XDG_CACHE_HOME": str(tmp_path / "home"), **own},
        check=True,
        timeout=120,
    )
    found = {path.parent.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*-cache")}
    assert found == ({folder} if folder else set())


def test_missing_gpu_is_said_without_a_traceback(tmp_path):
    done = run("rollout", "open_water_current", "--device", "gpu", "--out", str(tmp_path / "run"))
    if done.returncode == 0:
        pytest.skip("this machine has a GPU")
    assert done.returncode == 2
    assert "--device gpu" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("where", ["wall/run", "wall", "there"])
def test_a_place_that_cannot_be_had_is_refused_before_anything_is_computed(
    where, tmp_path, capsys, monkeypatch
):
    def computed(*_, **__):
        pytest.fail("worlds are prepared")

    monkeypatch.setattr("angler_mjx.runs.rollout.Simulator", computed)
    (tmp_path / "wall").write_text("a file where a folder is wanted")
    (tmp_path / "there").mkdir()
    with pytest.raises(SystemExit) as left:
        main(["rollout", "open_water_current", "--worlds", "1", "--out", str(tmp_path / where)])
    assert left.value.code == 2
    shown = capsys.readouterr()
    said = {"wall/run": "cannot be written", "wall": "exists", "there": "exists"}[where]
    assert said in shown.err
    assert shown.err.count("angler:") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there", "wall"]
