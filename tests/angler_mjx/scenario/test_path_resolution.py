"""Where paths begin: those of a file at its folder, those of who gives keys at theirs."""

import shutil
from pathlib import Path

import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import parts
from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies.benchmark import problem_settings
from angler_mjx.studies.fleet_size import conditions

SCENARIO = """
name = "near"
[time]
horizon_s = 60.0
[world]
preset = "open"
{world}
[[fleet]]
vehicle = "{vehicle}"
"""
GRID = '[[world.currents]]\ntype = "grid"\nfile = "sea.nc"'
VEHICLE = Path(library.__file__).parent / "data" / "bluerov2_heavy.toml"
PLANNER = "class Straight:\n    def plan(self, problem):\n        return None\n"


@pytest.fixture
def there(tmp_path, monkeypatch):
    """The folder of a scenario, with a vehicle; the working directory is another one."""
    folder, here = tmp_path / "there", tmp_path / "here"
    for place in (folder, here):
        place.mkdir()
        shutil.copy(VEHICLE, place / "own.toml")
        (place / "straight.py").write_text(PLANNER)
    monkeypatch.chdir(here)
    return folder


def write(folder, world="", vehicle="own.toml"):
    file = folder / "near.toml"
    file.write_text(SCENARIO.format(world=world, vehicle=vehicle))
    return file


def missing(act):
    with pytest.raises(ConfigError) as caught:
        act()
    return str(caught.value)


def test_what_a_file_names_lies_beside_it_whatever_is_set_otherwise(there):
    fleet = [{"vehicle": "bluerov2", "count": 2}]
    for given in ({}, {"fleet": fleet}, {"worlds": 2}):
        said = missing(lambda given=given: load_scenario(write(there, GRID), **given))
        assert str(there / "sea.nc") in said


def test_what_is_set_otherwise_begins_at_the_working_directory(there):
    here = Path.cwd()
    made = load_scenario(
        write(there),
        fleet=[{"vehicle": "./own.toml"}],
        planner={"name": "straight.py:Straight"},
    )
    assert made.fleet[0].vehicle == str(here / "own.toml")
    assert made.planner.name == f"{here / 'straight.py'}:Straight"
    assert load_scenario(write(there)).fleet[0].vehicle == str(there / "own.toml")
    grid = {"currents": [{"type": "grid", "file": "sea.nc"}]}
    assert str(here / "sea.nc") in missing(lambda: load_scenario(write(there), world=grid))
    floor = {"bathymetry": {"file": "sea.nc"}}
    assert str(here / "sea.nc") in missing(lambda: load_scenario(write(there), world=floor))


def test_a_sweep_takes_files_from_the_working_directory(there, capsys):
    file = write(there, '[[world.currents]]\ntype = "uniform"\nvelocity_mps = [0.1, 0, 0]')
    value = '{type="grid",file="./sea.nc"}'
    with pytest.raises(SystemExit):
        main(["sweep", str(file), "--set", f"world.currents.0={value}", "--out", "out"])
    assert str(Path.cwd() / "sea.nc") in capsys.readouterr().err


OTHERS = {
    "study": (
        conditions.read_study,
        "sizes = [1]\ndeadline_s = 50.0\n[axis.water.fast]\nworld = {{ currents = [{grid}] }}",
    ),
    "dataset": (
        lambda path: parts.build_parts(*parts.read_config(path), 4, str(path)),
        '[[expert]]\nname = "straight.py:Straight"\n'
        '[[scene]]\nname = "a"\nset = {{ world = {{ currents = [{grid}] }} }}',
    ),
    "benchmark": (
        problem_settings.read_benchmark,
        "set = {{ world = {{ currents = [{grid}] }} }}\n"
        '[[planner]]\nname = "straight.py:Straight"\n',
    ),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_a_file_that_sets_keys_of_a_scenario_takes_files_from_its_own_folder(kind, there, tmp_path):
    """Three folders: the scenario's, this file's, and the working directory, which has none."""
    read, text = OTHERS[kind]
    file = tmp_path / "theirs" / "file.toml"
    file.parent.mkdir()
    (file.parent / "straight.py").write_text(PLANNER)
    head = 'name = "a"\nscenario = "../there/near.toml"\n'
    write(there)
    file.write_text(head + text.format(grid='{ type = "grid", file = "sea.nc" }'))
    said = missing(lambda: read(file))
    assert str(file.parent / "sea.nc") in said, said
