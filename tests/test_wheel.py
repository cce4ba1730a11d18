"""The wheel, and that what it imports is what it declares."""

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGES = tuple(
    ROOT / place for place in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
)

DISTRIBUTION = {
    "PIL": "pillow",
    "google_crc32c": "google-crc32c",
    "mcap_ros2": "mcap-ros2-support",
    "mpl_toolkits": "matplotlib",
    "orbax": "orbax-checkpoint",
    "pinocchio": "pin",
    "pydantic_core": "pydantic",
    "rerun": "rerun-sdk",
}
"""Where a module comes from, if not from what is called like it."""

OF_EXTRAS = {
    "brax": "ppo",
    "cmaes": "tune",
    "coal": "plan",
    "grain": "learn",
    "gymnasium": "learn",
    "h5netcdf": "ocean",
    "cftime": "ocean",
    "h5py": "export",
    "minari": "export",
    "numba": "plan",
    "ompl": "plan",
    "optax": "learn",
    "orbax-checkpoint": "learn",
    "pin": "plan",
    "pymavlink": "sitl",
    "ray": "ray",
    "rerun-sdk": "view",
    "torch": "torch",
    "xarray": "learn",
}
"""Distributions that the package does without, and who brings them."""


def _names(requirements):
    return {re.match(r"[A-Za-z0-9._-]+", one)[0].lower() for one in requirements}


def _imported(path):
    """Names of other packages' modules that a file imports, and whether at once or when needed."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    late = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules = [node.module]
        else:
            continue
        for module in modules:
            yield module.partition(".")[0], id(node) in late


@cache
def _foreign():
    """All of them: distribution, file, whether when needed only."""
    own = {package.name for package in PACKAGES}
    return [
        (DISTRIBUTION.get(name, name), path.relative_to(ROOT), late)
        for package in PACKAGES
        for path in package.rglob("*.py")
        for name, late in _imported(path)
        if name not in own and name not in sys.stdlib_module_names
    ]


def test_what_is_imported_is_declared():
    declared = _names(PROJECT["project"]["dependencies"])
    extras = PROJECT["project"]["optional-dependencies"]
    missing = [
        (name, str(path))
        for name, path, _ in _foreign()
        if name not in declared and name not in _names(extras.get(OF_EXTRAS.get(name), ()))
    ]
    assert missing == []


def test_extras_are_imported_where_they_are_used_and_not_with_the_simulator():
    at_once = {
        (name, "planning/host" if "host" in path.parts else path.parts[1])
        for name, path, late in _foreign()
        if name in OF_EXTRAS and not late and path.parts[0] == "angler_mjx"
    }
    # The bridge is made of pymavlink; who draws replays is imported when one is drawn, and who
    # plans on the host when somebody names such a planner.
    # Who reads for a library of others, or gives it an environment, is imported by its users alone.
    at_once -= {("torch", "learning"), ("grain", "learning"), ("gymnasium", "learning")}
    of_host = {name for name, extra in OF_EXTRAS.items() if extra == "plan"}
    assert {room for name, room in at_once if name in of_host} <= {"planning/host"}
    assert {name for name, _ in at_once} - of_host <= {"rerun-sdk"}
    assert {room for name, room in at_once if name not in of_host} <= {"report", "teleop"}


def test_what_is_declared_is_imported():
    declared = _names(PROJECT["project"]["dependencies"])
    # MJX is mujoco.mjx, and in a distribution of its own.
    assert declared - {name for name, _, _ in _foreign()} == {"mujoco-mjx"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from what git tracks, elsewhere, so that nothing of this checkout helps."""
    if find_spec("pip") is None:
        pytest.skip("pip is not installed")
    place = tmp_path_factory.mktemp("wheel")
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if tracked.returncode:
        pytest.skip("not a git checkout")
    for name in filter(None, tracked.stdout.split("\0")):
        if (ROOT / name).is_file():
            (place / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            (place / "source" / name).write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(place)]
    built = subprocess.run(
        [*command, str(place / "source")], capture_output=True, text=True, check=False
    )
    if "hatchling" in built.stderr and "No matching distribution" in built.stderr:
        pytest.skip("hatchling cannot be had here")
    assert built.returncode == 0, built.stderr
    (path,) = place.glob("*.whl")
    return path


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
def test_the_wheel_holds_every_package_and_its_data_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as opened:
        held = {name for name in opened.namelist() if ".dist-info/" not in name}
    wanted = {
        str(path.relative_to(package.parent))
        for package in PACKAGES
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert held == wanted
    assert "angler_mjx/scenario/shipped/reef_fleet.toml" in held


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
def test_the_wheel_lists_its_scenarios_and_vehicles_away_from_any_checkout(wheel, tmp_path):
    """With what is installed here, but this checkout not on the path."""
    with zipfile.ZipFile(wheel) as opened:
        opened.extractall(tmp_path / "site")
    script = (
        "import sys; sys.path[:0] = [sys.argv.pop(1)]\n"
        "from angler_mjx.cli.main import main; import angler_mjx\n"
        "assert angler_mjx.__file__.startswith(sys.path[0]), angler_mjx.__file__\n"
        "main()\n"
    )
    for words, said in (
        (("scenarios", "show", "open_water_current"), "open_water_current"),
        (("vehicle", "show", "bluerov2_heavy"), "13.500 kg"),
    ):
        done = subprocess.run(
            [sys.executable, "-P", "-c", script, str(tmp_path / "site"), *words],
            cwd=tmp_path,
            env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "JAX_PLATFORMS": "cpu"},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert said in done.stdout
