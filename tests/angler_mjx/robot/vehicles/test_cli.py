"""``angler vehicle``: what is printed and what is written."""

import mujoco
import pytest

from angler_mjx.cli import vehicle
from angler_mjx.errors import ConfigError


def test_show_prints_the_numbers(capsys):
    vehicle.show_vehicle("bluerov2_heavy", "wu2018")
    text = capsys.readouterr().out
    for part in ("11.500 kg", "112.82 N", "2.56 m/s", "-0.7071", "0.1711", "natural roll period"):
        assert part in text


def test_show_follows_the_voltage(capsys):
    vehicle.show_vehicle("bluerov2", voltage_v=10.0)
    assert "10 V" in capsys.readouterr().out


def test_list_names_every_vehicle_and_set(capsys):
    vehicle.list_vehicles()
    text = capsys.readouterr().out
    for part in ("bluerov2_heavy", "von_benzon2022", "wu2018", "blue_ismc"):
        assert part in text


def test_export_writes_a_model_once(tmp_path, capsys):
    out = tmp_path / "rov.xml"
    vehicle.export_mjcf("bluerov2_heavy", out, "wu2018")
    assert capsys.readouterr().out.strip() == str(out)
    assert mujoco.MjModel.from_xml_path(str(out)).body_mass[1] == 11.5
    with pytest.raises(ConfigError, match="exists"):
        vehicle.export_mjcf("bluerov2_heavy", out)


def test_export_into_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        vehicle.export_mjcf("bluerov2_heavy", tmp_path / "none" / "rov.xml")


def test_a_wrong_set_leaves_no_file(tmp_path):
    out = tmp_path / "rov.xml"
    with pytest.raises(ConfigError, match="no parameter set"):
        vehicle.export_mjcf("bluerov2_heavy", out, "nope")
    assert not out.exists()
