"""Copies of vehicle files in run folders, and who reads them."""

import tomllib

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import input_copies
from angler_mjx.testing.referee import vehicles


def test_vehicle_files_with_byte_order_marks_are_copied_and_read(tmp_path):
    shipped = library.locate_vehicle("bluerov2")
    model = library.load_vehicle("bluerov2").rotor.model
    text = shipped.read_text().replace(f'model = "{model}"', 'model = "motor.toml"')
    thruster = library.locate_thruster(model).read_text()
    for name, content in (("rov.toml", text), ("motor.toml", thruster)):
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + content.encode())
    run = tmp_path / "run"
    run.mkdir()
    source = format_path(tmp_path / "rov.toml")
    input_copies.copy_inputs(run, [source])
    copies = input_copies.vehicle_copies(run)
    copy = tomllib.loads(copies[source].read_text(encoding="utf-8"))
    assert copy["rotor"]["model"].startswith("../")
    robot = vehicles.read_robot({"vehicle": source, "battery_v": 16.0}, copies)
    np.testing.assert_array_equal(robot.pwm_us, tomllib.loads(thruster)["pwm_us"])


GAINED = """
[parameter_sets.gained]
description = "Made up"
{uncertain}
"""


@pytest.mark.parametrize(
    ("change", "goes_on"),
    [
        (lambda text: text, True),
        (lambda text: f"# a comment\n{text}", True),
        (lambda text: text + GAINED.format(uncertain="uncertainty = {volume_m3 = 0.1}"), True),
        (lambda text: text + GAINED.format(uncertain=""), False),  # robots may sample it
        (lambda text: text.replace("mass_kg = ", "mass_kg = 1"), False),
        (lambda text: text.replace("[parameter_sets.wu2018", "[parameter_sets.other"), False),
    ],
)
def test_a_run_goes_on_where_its_vehicle_gained_sets_with_an_uncertainty(
    tmp_path, monkeypatch, change, goes_on
):
    shipped = library.locate_vehicle("bluerov2_heavy")
    named = tmp_path / "rov.toml"
    named.write_text(shipped.read_text())
    thruster = library.locate_thruster(library.load_vehicle("bluerov2_heavy").rotor.model)
    both = {"role": input_copies.THRUSTER, "named": "t200", "path": thruster}
    motor = input_copies._CurrentFile(data=thruster.read_bytes(), **both)

    def read_files(name):
        data = named.read_bytes()
        role = input_copies.VEHICLE
        return input_copies._CurrentFile(role=role, named=name, path=named, data=data), motor

    monkeypatch.setattr(input_copies, "_vehicle_files", read_files)
    run = tmp_path / "run"
    run.mkdir()
    input_copies.copy_inputs(run, ["rov"])
    named.write_text(change(named.read_text()))
    assert (input_copies.stand_ins(run) == {}) == goes_on
    if goes_on:
        input_copies.require_unchanged(run, flag="--resume")
    else:
        with pytest.raises(ConfigError, match="rov or its thruster file was edited"):
            input_copies.require_unchanged(run, flag="--resume")
