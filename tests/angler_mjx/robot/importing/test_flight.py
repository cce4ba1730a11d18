"""Imported vehicles are shown, load and fly."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from angler_mjx.cli import main
from angler_mjx.cli.vehicle import import_vehicle
from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.drive import wrench_matrix
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.properties import describe_vehicle
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import load_scenario

OTTER = Path(__file__).parents[4] / "docs/examples/otter.urdf"
T200 = Path(library.__file__).parent / "data/thrusters/t200.toml"
DENSITY = 1000.0
"""Of the scenario's water, kg/m^3."""

SCENARIO = """
schema_version = 1
name = "imported"
engine = "fused"
worlds = 1

[time]
horizon_s = 3.0

[world]
preset = "open"
shape = [6, 6, 5]

[[fleet]]
vehicle = "otter.toml"
count = 2
"""


@pytest.fixture(scope="module")
def otter(tmp_path_factory):
    out = tmp_path_factory.mktemp("otter") / "otter.toml"
    import_vehicle(OTTER, thruster="t200", out=out)
    return out


def test_an_imported_vehicle_flies(otter):
    path = otter.parent / "imported.toml"
    path.write_text(SCENARIO)
    run = rollout(load_scenario(path), out=otter.parent / "run")
    position = np.asarray(run.trajectories["p_m"][...])[0, :, 0]
    pwm_us = np.asarray(run.trajectories["pwm_us"][...])[0, -1, 0]
    assert np.linalg.norm(position - position[0], axis=1).max() < 0.01
    # It floats by 0.264 kg, which its two vertical thrusters push down.
    table = tomllib.loads(T200.read_text())
    thrust_n = np.array(table["thrust_n"])[:, table["voltage_v"].index(16)]
    pushed = np.interp(pwm_us[4:], table["pwm_us"], thrust_n).sum()
    assert pushed == pytest.approx(DENSITY * 0.44 * 0.32 * 0.08 * 9.81 - 11 * 9.81, rel=0.1)


def test_an_imported_vehicle_reaches_its_goal(otter):
    path = otter.parent / "goal.toml"
    text = SCENARIO.replace("horizon_s = 3.0", "horizon_s = 60.0").replace("count = 2\n", "")
    path.write_text(text)
    run = rollout(load_scenario(path), out=otter.parent / "goal")
    assert run.episodes["outcome"].to_pylist() == ["reached"]


def test_its_terminal_speed_is_that_of_its_file(otter):
    shown = describe_vehicle(load_vehicle(str(otter)), None, 16.0)
    # Forward, thrusters 3 and 4 push at their upper limit and 1 and 2 at their lower one.
    thrust = 2 * 0.5**0.5 * (51.44 + 39.91)
    speed = (-4 + np.sqrt(16 + 4 * 30 * thrust)) / (2 * 30)
    assert shown.terminal_speed_mps[0] == pytest.approx(speed, rel=1e-3)
    matrix = wrench_matrix(load_vehicle(str(otter)))
    assert matrix[:3, 4] == pytest.approx([0, 0, -1])
    assert matrix[3:, 4] == pytest.approx(np.cross([0, -0.12, 0.09], [0, 0, -1]))


def test_the_list_heads_the_file_and_is_printed(otter, tmp_path, capsys):
    import_vehicle(OTTER, thruster="t200", out=tmp_path / "again.toml")
    printed = capsys.readouterr().out.splitlines()
    comments = [
        line[2:] for line in (tmp_path / "again.toml").read_text().splitlines() if line[:2] == "# "
    ]
    assert comments[1:] == printed[:-2]
    assert "net buoyancy +0.264 kg" in printed[-2]
    assert printed[-1] == str(tmp_path / "again.toml")


def test_a_file_is_not_replaced_and_a_thruster_is_required(otter, tmp_path):
    with pytest.raises(ConfigError, match="exists"):
        import_vehicle(OTTER, thruster="t200", out=otter)
    with pytest.raises(ConfigError, match="--thruster t200"):
        import_vehicle(OTTER, out=tmp_path / "a.toml")
    with pytest.raises(ConfigError, match="NAME:=VALUE"):
        import_vehicle(OTTER, thruster="t200", xacro_args=("a=b",))
    with pytest.raises(ConfigError, match="no folder"):
        import_vehicle(OTTER, thruster="t200", packages=(tmp_path / "none",))
    with pytest.raises(ConfigError, match="density = 1"):
        import_vehicle(OTTER, thruster="t200", density=1.0)


def test_a_thruster_file_is_named_from_the_vehicle_file(otter, tmp_path, monkeypatch):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/strong.toml").write_text(T200.read_text())
    (tmp_path / "fleet").mkdir()
    monkeypatch.chdir(tmp_path)
    import_vehicle(OTTER, thruster="parts/strong.toml", out=Path("fleet/otter.toml"))
    assert 'model = "../parts/strong.toml"' in Path("fleet/otter.toml").read_text()
    shown = describe_vehicle(load_vehicle("fleet/otter.toml"), None, 16.0)
    assert shown.terminal_speed_mps[0] > 1


def test_flags_reach_the_import(tmp_path, monkeypatch):
    """Packages, --xacro-args and --yaml, as typed."""
    text = OTTER.read_text().replace('value="11.0"', 'value="$(arg mass)"')
    (tmp_path / "otter.urdf.xacro").write_text(text)
    (tmp_path / "T.yaml").write_text("thruster_manager: {max_thrust: 40}")
    monkeypatch.chdir(tmp_path)
    words = "vehicle import otter.urdf.xacro --thruster t200 --yaml T.yaml --packages ."
    main.main([*words.split(), "--xacro-args", "mass:=11.1"])
    written = (tmp_path / "otter.toml").read_text()
    assert "mass_kg = 11.1\n" in written
    assert "max_thrust = 40" in written
