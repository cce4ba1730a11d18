"""Copies of vehicle files in run folders, and who reads them."""

import tomllib

import numpy as np

from angler_mjx.files import named
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.storage import inputs
from angler_mjx.testing.referee import vehicles


def test_vehicle_files_with_byte_order_marks_are_copied_and_read(tmp_path):
    shipped = library.locate("bluerov2")
    model = library.load("bluerov2").rotor.model
    text = shipped.read_text().replace(f'model = "{model}"', 'model = "motor.toml"')
    thruster = library.locate_thruster(model).read_text()
    for name, content in (("rov.toml", text), ("motor.toml", thruster)):
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + content.encode())
    run = tmp_path / "run"
    run.mkdir()
    source = named(tmp_path / "rov.toml")
    inputs.take(run, [source])
    copies = inputs.copies(run)
    copy = tomllib.loads(copies[source].read_text(encoding="utf-8"))
    assert copy["rotor"]["model"].startswith("../")
    robot = vehicles.read({"vehicle": source, "battery_v": 16.0}, copies)
    np.testing.assert_array_equal(robot.pwm_us, tomllib.loads(thruster)["pwm_us"])
