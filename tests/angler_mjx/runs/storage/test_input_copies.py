"""Copies of vehicle files in run folders, and who reads them."""

import tomllib

import numpy as np

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
