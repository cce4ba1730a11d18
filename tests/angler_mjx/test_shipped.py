"""Files that ship, by name."""

from pathlib import Path

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.shipped import find_shipped, list_shipped

PACKAGES = {
    "angler_mjx.scenario": "reef_fleet",
    "angler_mjx.studies.benchmark": "reference",
    "angler_mjx.studies.fleet_size": "survey_reef",
    "angler_mjx.learning.datasets": "reef",
}


@pytest.mark.parametrize(("package", "name"), PACKAGES.items())
def test_a_name_is_the_file_that_ships(package, name):
    path = find_shipped(name, package, "file")
    assert path.is_file()
    assert path == list_shipped(package)[name]


def test_a_name_comes_before_a_folder_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reference").mkdir()
    package = "angler_mjx.studies.benchmark"
    assert find_shipped("reference", package, "benchmark", folders=True).suffix == ".toml"
    assert find_shipped("./reference/", package, "benchmark", folders=True) == Path("reference")


def test_an_unknown_name_is_refused_with_those_that_ship(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    package = "angler_mjx.studies.fleet_size"
    for name in ("survey_ref", "mine"):
        with pytest.raises(ConfigError, match=f"unknown study '{name}'; there is .*survey_reef"):
            find_shipped(name, package, "study")
    assert find_shipped("no/such.toml", package, "study") == Path("no/such.toml")


def test_a_file_that_exists_may_have_any_name(tmp_path):
    path = tmp_path / "study.txt"
    path.touch()
    assert find_shipped(path, "angler_mjx.studies.fleet_size", "study") == path


@pytest.mark.parametrize("folders", [True, False])
def test_a_name_too_long_for_a_path_is_unknown(folders):
    with pytest.raises(ConfigError, match="unknown benchmark 'xxx"):
        find_shipped("x" * 10_000, "angler_mjx.studies.benchmark", "benchmark", folders=folders)
