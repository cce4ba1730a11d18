"""The ground: pinned versions, metadata, scenarios that ship, and the commands of the Makefile."""

import re
import stat
import subprocess
import tomllib
from pathlib import Path

import pytest

import angler_mjx
from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.scenario import load_scenario, shipped_scenarios

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
INSTALLED_EXTRAS = ("view", "plan", "sitl", "dev", "mutants")


def _canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def _constraints():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    return [line for line in lines if line and not line.startswith("#")]


@pytest.fixture(scope="module")
def pinned():
    return dict((_canonical(n), v) for n, v in (line.split("==") for line in _constraints()))


def test_constraints_hold_names_and_exact_versions_only():
    for line in _constraints():
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.+!]*", line), line


def test_constraints_cover_what_is_installed_directly(pinned):
    wanted = list(PROJECT["dependencies"])
    for extra in INSTALLED_EXTRAS:
        wanted += PROJECT["optional-dependencies"][extra]
    names = {_canonical(re.match(r"[A-Za-z0-9._-]+", line)[0]) for line in wanted}
    assert names <= set(pinned)


def test_constraints_leave_accelerator_packages_out(pinned):
    """All but the compiler, by which tests compile kernels without a device."""
    found = {name for name in pinned if "cuda" in name or "nvidia" in name}
    assert found == {"nvidia-cuda-nvrtc"}


def test_mujoco_and_mjx_are_pinned_to_one_version(pinned):
    assert pinned["mujoco"] == pinned["mujoco-mjx"]
    assert pinned["mujoco"].startswith("3.17.")


def test_citation_names_this_version_and_license():
    text = (ROOT / "CITATION.cff").read_text()
    assert re.search(r'^version: "(.*)"$', text, re.M)[1] == angler_mjx.__version__
    assert re.search(r"^license: (.*)$", text, re.M)[1] == PROJECT["license"]


def test_license_is_the_whole_apache_text():
    text = (ROOT / "LICENSE").read_text()
    assert "Version 2.0, January 2004" in text
    assert "END OF TERMS AND CONDITIONS" in text
    assert "limitations under the License." in text


def test_ci_script_can_be_executed():
    assert (ROOT / ".ci" / "run").stat().st_mode & stat.S_IXUSR


def test_no_file_is_tracked_that_is_ignored():
    listed = ["git", "-C", str(ROOT), "ls-files", "--cached", "--ignored", "--exclude-standard"]
    done = subprocess.run(listed, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no git repository: {done.stderr.strip()}")
    assert done.stdout.split() == []


def test_make_help_lists_the_two_commands():
    listed = subprocess.run(
        ["make", "-s", "-C", str(ROOT), "help"], capture_output=True, text=True, check=True
    ).stdout
    assert "make demo" in listed
    assert "make test" in listed


def test_scenarios_of_the_package_are_the_named_ones():
    assert set(shipped_scenarios()) == {
        "bay_torpedoes",
        "carry_arms",
        "carry_pipe",
        "corridor_delivery",
        "dense_dynamic",
        "harbour_surface",
        "heterogeneous",
        "open_water_current",
        "reef_arms",
        "reef_debris",
        "reef_fleet",
        "reef_survey",
        "shelf_gliders",
        "sitl_formation",
        "sitl_hold",
        "work_class",
    }


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
def test_shipped_scenario_is_valid_and_named_after_its_file(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description


def test_reef_fleet_is_the_demo():
    demo = load_scenario("reef_fleet")
    assert (demo.worlds, len(demo.members()), demo.time.horizon_s) == (256, 4, 120.0)
    assert len({entry.vehicle for entry in demo.fleet}) == 2
    assert demo.world.obstacles.dynamic.count == 12
    assert demo.world.obstacles.dynamic.radius_m == (0.4, 0.75)


def test_heterogeneous_holds_every_rigid_vehicle_with_every_published_set():
    held = {
        (variant.vehicle, variant.parameter_set)
        for member in load_scenario("heterogeneous").members()
        for variant in member.variants
    }
    shipped_sets = {
        (name, chosen)
        for name in library.list_rovs()
        if not library.load_vehicle(name).links
        for chosen in library.load_vehicle(name).published_sets
    }
    assert held == shipped_sets


def test_jax_has_an_upper_bound_below_the_version_that_may_drop_what_we_use(pinned):
    lines = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["gpu"]]
    bounds = [line for line in lines if re.match(r"jax\b", line)]
    assert len(bounds) == 2
    assert all(line.endswith(">=0.11.2,<0.12") for line in bounds)
    assert pinned["jax"].startswith("0.11.")


def test_one_private_name_of_jax_is_used():
    """Each is a promise that nobody made; what is named here says why there is no public one."""
    packages = ("angler_mjx", "kernels", "sitl_bridge", "experiments", "tools")
    files = [file for package in packages for file in (ROOT / package).rglob("*.py")]
    lines = [
        (file.relative_to(ROOT).as_posix(), line.strip())
        for file in files
        for line in file.read_text().splitlines()
        if re.match(r"\s*(from|import) jax\._src", line)
    ]
    assert lines == [("angler_mjx/runs/processes.py", "from jax._src import distributed")]


def test_the_private_name_of_jax_is_what_shared_runs_expect():
    from jax._src import distributed
    from jaxlib import _jax

    assert distributed.global_state.client is None
    for name in ("key_value_set", "key_value_dir_get"):
        assert callable(getattr(_jax.DistributedRuntimeClient, name))
