"""The wheel, and that what it imports is what it declares."""

import ast
import email
import os
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
DISTRIBUTIONS = {"angler-mjx": ROOT, "angler-experiments": ROOT / "experiments"}
"""Name of each distribution, and the folder of its project."""
PROJECTS = {
    name: tomllib.loads((folder / "pyproject.toml").read_text())
    for name, folder in DISTRIBUTIONS.items()
}
PACKAGES = {
    name: tuple(
        DISTRIBUTIONS[name] / path
        for path in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    )
    for name, project in PROJECTS.items()
}

DISTRIBUTION = {
    "PIL": "pillow",
    "angler_kernels": "angler-mjx",
    "angler_mjx": "angler-mjx",
    "angler_sitl": "angler-mjx",
    "foxglove": "foxglove-sdk",
    "google_crc32c": "google-crc32c",
    "mcap_ros2": "mcap-ros2-support",
    "mpl_toolkits": "matplotlib",
    "orbax": "orbax-checkpoint",
    "pinocchio": "pin",
    "pydantic_core": "pydantic",
    "rerun": "rerun-sdk",
    "yaml": "pyyaml",
    "zenoh": "eclipse-zenoh",
}
"""Where a module comes from, if not from what is called like it."""

OF_EXTRAS = {
    "av": "video",
    "brax": "ppo",
    "cmaes": "tune",
    "coal": "plan",
    "grain": "learn",
    "gymnasium": "learn",
    "eclipse-zenoh": "live",
    "foxglove-sdk": "live",
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
OF_EXPERIMENTS = OF_EXTRAS | {"xarray": "ocean"}
"""The same of the experiments, which need no extra of the package."""


OF_ROS = {"rclpy"}
"""Modules that come with an installation of ROS 2, which no extra can bring."""


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
def _foreign(distribution):
    """All of a distribution: where imported from, file, whether when needed only."""
    shipped = {package.name for package in PACKAGES[distribution]}
    return [
        (DISTRIBUTION.get(name, name), path.relative_to(ROOT), late)
        for package in PACKAGES[distribution]
        for path in package.rglob("*.py")
        for name, late in _imported(path)
        if name not in {*shipped, *sys.stdlib_module_names, "_typeshed"}
    ]


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_what_is_imported_is_declared(distribution):
    project = PROJECTS[distribution]["project"]
    declared = _names(project["dependencies"])
    extras = project["optional-dependencies"]
    of_extras = OF_EXTRAS if distribution == "angler-mjx" else OF_EXPERIMENTS
    missing = [
        (name, str(path))
        for name, path, _ in _foreign(distribution)
        if name not in OF_ROS | declared and name not in _names(extras.get(of_extras.get(name), ()))
    ]
    assert missing == []


def test_extras_are_imported_where_they_are_used_and_not_with_the_simulator():
    at_once = {
        (name, "planning/host" if "host" in path.parts else path.parts[1])
        for name, path, late in _foreign("angler-mjx")
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
    for distribution, more in (("angler-mjx", {"mujoco-mjx"}), ("angler-experiments", set())):
        declared = _names(PROJECTS[distribution]["project"]["dependencies"])
        # MJX is mujoco.mjx, and in a distribution of its own.
        assert declared - {name for name, _, _ in _foreign(distribution)} == more


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Path by distribution, built from what git tracks, so that nothing of this checkout helps."""
    if find_spec("pip") is None:
        pytest.skip("pip is not installed")
    folder_of_wheels = tmp_path_factory.mktemp("wheel")
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if tracked.returncode:
        pytest.skip("not a git checkout")
    for name in filter(None, tracked.stdout.split("\0")):
        if (ROOT / name).is_file():
            (folder_of_wheels / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder_of_wheels / "source" / name).write_bytes((ROOT / name).read_bytes())
    return {
        name: _build(
            folder_of_wheels / "source" / folder.relative_to(ROOT), folder_of_wheels / name
        )
        for name, folder in DISTRIBUTIONS.items()
    }


def _build(source, folder_of_wheels):
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "-w",
        str(folder_of_wheels),
    ]
    built = subprocess.run([*command, str(source)], capture_output=True, text=True, check=False)
    if "hatchling" in built.stderr and "No matching distribution" in built.stderr:
        pytest.skip("hatchling cannot be had here")
    assert built.returncode == 0, built.stderr
    (path,) = folder_of_wheels.glob("*.whl")
    return path


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_a_wheel_holds_every_package_and_its_data_and_nothing_else(wheels, distribution):
    with zipfile.ZipFile(wheels[distribution]) as opened:
        held = {name for name in opened.namelist() if ".dist-info/" not in name}
    wanted = {
        str(path.relative_to(package.parent))
        for package in PACKAGES[distribution]
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert held == wanted
    assert ("angler_mjx/scenario/shipped/reef_fleet.toml" in held) == (distribution == "angler-mjx")


def _dist_info(wheel, name):
    with zipfile.ZipFile(wheel) as opened:
        (path,) = [path for path in opened.namelist() if path.endswith(f".dist-info/{name}")]
        return opened.read(path).decode()


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_metadata_of_a_wheel(wheels, distribution):
    metadata = email.message_from_string(_dist_info(wheels[distribution], "METADATA"))
    project = PROJECTS[distribution]["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert metadata["Name"] == distribution
    assert metadata["Version"] == re.search(r'^version: "(.*)"$', citation, re.M)[1]
    assert metadata["License-Expression"] == "Apache-2.0"
    assert metadata["Requires-Python"] == project["requires-python"]
    assert _dist_info(wheels[distribution], "licenses/LICENSE") == (ROOT / "LICENSE").read_text()
    readme = (DISTRIBUTIONS[distribution] / "README.md").read_text()
    assert metadata.get_payload().strip() == readme.strip()
    requirements = [line for line in metadata.get_all("Requires-Dist") if "extra ==" not in line]
    assert len(requirements) == len(project["dependencies"])
    entries = _dist_info(wheels[distribution], "entry_points.txt")
    for name, target in project["entry-points"]["angler_mjx.planners"].items():
        assert f"{name} = {target}" in entries
    assert ("angler = angler_mjx.cli.main:main" in entries) == (distribution == "angler-mjx")


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
def test_a_wheel_built_later_has_the_same_bytes(wheels, tmp_path, monkeypatch):
    """At one time of the commit, whatever the times of the files are."""
    source = wheels["angler-mjx"].parents[1] / "source"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    first = _build(source, tmp_path / "first").read_bytes()
    for path in source.rglob("*.py"):
        os.utime(path, (1.8e9, 1.8e9))
    assert _build(source, tmp_path / "second").read_bytes() == first


def _install(site, *paths):
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    done = subprocess.run(
        [*command, "--target", str(site), *map(str, paths)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def _run(site, script, *words):
    """Run a script with what is installed here, but packages of ours from wheels alone."""
    begin = (
        "import sys; site = sys.argv.pop(1); sys.path[:0] = [site]\n"
        "sys.path = [x for x in sys.path if x == site or 'site-packages' in x or 'lib/' in x]\n"
    )
    return subprocess.run(
        [sys.executable, "-P", "-c", begin + script, str(site), *words],
        cwd=site,
        env={"PATH": "/usr/bin:/bin", "HOME": str(site), "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


COMMAND = """
import angler_mjx
assert angler_mjx.__file__.startswith(sys.path[0]), angler_mjx.__file__
from angler_mjx.cli.main import main
main()
"""
LEARNED = """
from importlib.metadata import entry_points
import angler_mjx
assert angler_mjx.__file__.startswith(sys.path[0]), angler_mjx.__file__
(learned,) = entry_points(group="angler_mjx.planners", name="learned")
print(learned.load().__module__)
"""


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("scenarios", "show", "open_water_current"), 0, "open_water_current"),
        (("vehicle", "show", "bluerov2_heavy"), 0, "13.500 kg"),
        # Refused for what is asked of a file that was found and read.
        (("benchmark", "fleets", "--presets", "nowhere"), 2, "nowhere"),
        (("benchmark", "reference", "--presets", "nowhere"), 2, "nowhere"),
        (("study", "fleet_size", "survey_reef", "--only", "nothing"), 2, "nothing"),
        (("dataset", "make", "reef", "--episodes", "0"), 2, "--episodes 0: must be at least 1"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_the_wheel_alone_reads_the_files_that_it_ships(wheels, tmp_path, words, code, text):
    _install(tmp_path / "site", wheels["angler-mjx"])
    done = _run(tmp_path / "site", COMMAND, *words)
    assert done.returncode == code, done.stderr
    assert text in (done.stderr if code else done.stdout)
    assert "Traceback" not in done.stderr


@pytest.mark.nightly(by="test_what_is_imported_is_declared")
def test_the_wheel_of_experiments_brings_its_planner(wheels, tmp_path):
    _install(tmp_path / "site", *wheels.values())
    done = _run(tmp_path / "site", LEARNED)
    assert done.stdout.strip() == "angler_experiments.learned_planner.planner", done.stderr
