"""Parameters: what is written, what the firmware makes of it, and which vehicles it can steer."""

import copy
import re
from dataclasses import replace

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import list_rovs, load_vehicle
from angler_mjx.studies.tuning import gain_files
from angler_sitl.firmware import parameters, probe
from angler_sitl.firmware.airframe import MIXER_FACTORS, find_frame
from angler_sitl.firmware.parameters import (
    LEVELS,
    SOURCES,
    explain_parameter,
    find_differences,
    for_vehicle,
)

HEAVY = load_vehicle("bluerov2_heavy")


def changed(change):
    """The Heavy with its file changed."""
    data = copy.deepcopy(HEAVY.model_dump())
    change(data)
    return VehicleConfig.model_validate(data)


@pytest.mark.parametrize("name", list_rovs())
def test_shipped_vehicles_are_frames_of_the_firmware(name):
    frame = find_frame(load_vehicle(name))
    # By upstream's own names: SUB_FRAME_VECTORED 1, SUB_FRAME_VECTORED_6DOF 2.
    number = {"vectored": 1, "vectored_6dof": 2}[frame]
    assert len(load_vehicle(name).thrusters.layout) == len(MIXER_FACTORS[frame])
    assert for_vehicle(load_vehicle(name), "guided", "vision")["FRAME_CONFIG"] == number


def test_a_vehicle_without_a_frame_is_refused():
    with pytest.raises(ConfigError, match=r"bluerov2_heavy.*\[ardusub\].*vectored_6dof"):
        for_vehicle(changed(lambda data: data.update(ardusub=None)), "guided", "vision")


def test_a_frame_of_other_thrusters_is_refused():
    with pytest.raises(ConfigError, match=r"8 thrusters.*'vectored' has 6"):
        find_frame(changed(lambda data: data["ardusub"].update(frame="vectored")))


@pytest.mark.parametrize(
    ("swap", "axes"), [((0, 1), "yaw, lateral"), ((4, 6), "pitch"), ((4, 5), "roll")]
)
def test_thrusters_in_another_order_are_refused(swap, axes):
    def exchange(data):
        layout = list(data["thrusters"]["layout"])
        i, j = swap
        layout[i], layout[j] = layout[j], layout[i]
        data["thrusters"]["layout"] = layout

    with pytest.raises(ConfigError, match=f"motor {swap[0] + 1} of .* in {axes};"):
        find_frame(changed(exchange))


def test_a_thruster_turned_around_is_refused():
    def turn(data):
        data["thrusters"]["layout"][6]["direction"] = (0.0, 0.0, 1.0)

    with pytest.raises(ConfigError, match=r"thruster_7.*motor 7.*roll, pitch, throttle"):
        find_frame(changed(turn))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("source", SOURCES)
def test_every_value_has_its_reason_and_a_name_that_mavlink_can_carry(level, source):
    given = for_vehicle(HEAVY, level, source)
    assert all(explain_parameter(name) for name in given)
    # PARAM_VALUE has 16 characters for a name.
    assert all(len(name) <= 16 for name in given)


def test_thrusters_are_passed_through_at_that_level_only():
    given = for_vehicle(HEAVY, "thrusters", "vision")
    # Functions RCIN1 to RCIN8 of the firmware.
    assert [given[f"SERVO{n}_FUNCTION"] for n in range(1, 9)] == list(range(51, 59))
    assert "SERVO9_FUNCTION" not in given
    assert not any(name.startswith("SERVO") for name in for_vehicle(HEAVY, "guided", "vision"))


@pytest.mark.parametrize(("level", "source"), [("stabilise", "vision"), ("guided", "dvl")])
def test_unknown_levels_and_sources_are_refused(level, source):
    with pytest.raises(ConfigError, match="choose one of"):
        for_vehicle(HEAVY, level, source)


def test_a_file_says_what_was_given_with_old_names_and_new(tmp_path):
    given = {"GPS1_TYPE": 0.0, "EK3_SRC1_YAW": 6.0, "BARO_SPEC_GRAV": 1.024}
    parameters.write_parameters(tmp_path / "some.parm", given)
    read = {}
    for line in (tmp_path / "some.parm").read_text().splitlines():
        name, value = line.partition("#")[0].split()
        read[name] = float(value)
    assert read == {**given, "GPS_TYPE": 0.0}


def test_differences_are_told_and_nothing_else():
    ours = {"GPS1_TYPE": 0.0, "FS_GCS_ENABLE": 0.0, "BARO_SPEC_GRAV": 1.024, "VISO_TYPE": 1.0}
    # float32, as it comes over the line.
    read = {"GPS_TYPE": 0.0, "FS_GCS_ENABLE": 2.0, "BARO_SPEC_GRAV": 1.0240000486373901, "X": 3.0}
    assert find_differences(ours, read) == [
        "FS_GCS_ENABLE = 0: the autopilot has 2",
        "VISO_TYPE = 1: unknown to this firmware",
    ]
    assert find_differences({}, read) == []


@pytest.mark.sitl
@pytest.mark.parametrize("name", list_rovs())
@pytest.mark.parametrize("source", SOURCES)
def test_the_real_one_takes_every_parameter(ardusub, tmp_path, name, source):
    vehicle = load_vehicle(name)
    given = {}
    for level in LEVELS:
        given |= for_vehicle(vehicle, level, source)
    with probe.start_stationary(ardusub, tmp_path, given) as still:
        said = probe.query_autopilot(still)
    assert find_differences(given, said.parameters) == []
    assert len(said.parameters) > 1000


@pytest.mark.sitl
def test_the_real_one_does_not_know_what_is_not_there(ardusub, tmp_path):
    given = {"NO_SUCH_THING": 1.0, "FS_GCS_ENABLE": 0.0}
    with probe.start_stationary(ardusub, tmp_path, given) as still:
        read = probe.query_autopilot(still).parameters
    assert find_differences(given, read) == ["NO_SUCH_THING = 1: unknown to this firmware"]


@pytest.mark.sitl
def test_the_real_one_passes_channels_to_thrusters(ardusub, tmp_path):
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    given = for_vehicle(HEAVY, "thrusters", "vision")
    wanted = (1410, 1430, 1450, 1470, 1530, 1550, 1570, 1590)
    with probe.start_stationary(ardusub, tmp_path, given) as still:
        # 0 until the first override, which is no pulse: off.
        assert still.pwm[:8] == (0,) * 8
        channels = [*wanted, *[0] * 10]
        still.send(mavlink.MAVLink_rc_channels_override_message(still.sysid, 1, *channels))
        # 17.5 ms of its clock at most were seen.
        assert still.step_until(lambda: still.pwm[:8] == wanted, 0.1)


def test_a_tuned_file_is_read_as_it_was_written(tmp_path):
    tuned = replace(gain_files.FIRMWARE_DEFAULTS, PSC_POSXY_P=1.8, ATC_RAT_YAW_I=0.004165)
    file = tmp_path / "ardusub.param"
    file.write_text(gain_files.format_param_file(tuned, 8, ["tuned", "twice"]), encoding="utf-8")
    assert parameters.read_parameters(file) == {"PSC_POSXY_P": 1.8, "ATC_RAT_YAW_I": 0.004165}


def test_words_and_remarks_in_a_file(tmp_path):
    file = tmp_path / "mav.parm"
    file.write_text(
        "PSC_POSXY_P      1.5  # stiffer\n\n# none\nFS_GCS_ENABLE,0\n", encoding="utf-8"
    )
    assert parameters.read_parameters(file) == {"PSC_POSXY_P": 1.5, "FS_GCS_ENABLE": 0.0}


@pytest.mark.parametrize("line", ["PSC_POSXY_P", "A,B", "A,1,2", "A,nan", f"{'A' * 17},1"])
def test_a_line_that_is_none_is_named(tmp_path, line):
    file = tmp_path / "bad.param"
    file.write_text(f"A,1\n{line}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"bad\.param:2: .*write NAME,VALUE"):
        parameters.read_parameters(file)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.param: cannot be read"):
        parameters.read_parameters(tmp_path / "none.param")


QGROUNDCONTROL = """# Onboard parameters for Vehicle 1
#
# Stack: ArduPilot
# Vehicle: Sub
# Version: 4.5.5
# Git Revision: 3f7fbbee
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tACRO_BAL_PITCH\t1.000000000000000000\t9
1\t1\tANGLE_MAX\t4500\t4
1\t1\tBATT_SERIAL_NUM\t-1\t6
"""


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_parameter_file_of_qgroundcontrol_is_read(tmp_path, newline):
    file = tmp_path / "vehicle.params"
    file.write_bytes(QGROUNDCONTROL.replace("\n", newline).encode())
    expected = {"ACRO_BAL_PITCH": 1.0, "ANGLE_MAX": 4500.0, "BATT_SERIAL_NUM": -1.0}
    assert parameters.read_parameters(file) == expected


def test_both_files_of_a_tuning_give_the_same_parameters(tmp_path):
    gains = replace(gain_files.FIRMWARE_DEFAULTS, PSC_POSXY_P=1.8, ATC_RAT_YAW_I=0.004165)
    files = {
        "ardusub.param": gain_files.format_param_file,
        "ardusub.params": gain_files.format_params_file,
    }
    values = []
    for name, write in files.items():
        (tmp_path / name).write_text(write(gains, 8, ["tuned"]))
        values.append(parameters.read_parameters(tmp_path / name))
    assert values[0] == values[1]
    assert values[0]["PSC_POSXY_P"] == 1.8


def test_parameters_of_two_vehicles_are_refused(tmp_path):
    file = tmp_path / "fleet.params"
    file.write_text("1\t1\tPSC_POSXY_P\t2.5\t9\n2\t1\tPSC_POSXY_P\t3.5\t9\n")
    with pytest.raises(ConfigError, match=r"fleet\.params:2: .*system '2' after system '1'"):
        parameters.read_parameters(file)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1\t154\tGMB_OFFJNT_X\t0\t9", "component '154' is not the autopilot"),
        ("1\t1\tANGLE_MAX\tmany\t4", "write NAME,VALUE"),
        ("1\t1\tANGLE_MAX\t4500", "write NAME,VALUE"),
        ("1 1", "write NAME,VALUE"),
    ],
)
def test_a_line_that_is_not_understood_is_refused_by_number(tmp_path, line, message):
    file = tmp_path / "vehicle.params"
    file.write_text("# comment\n" + line + "\n")
    with pytest.raises(ConfigError, match=r"vehicle\.params:2: .*" + re.escape(message)):
        parameters.read_parameters(file)


def test_files_of_both_ground_stations_come_back(tmp_path):
    values = {"WPNAV_SPEED": 30.0, "SYSID_THISMAV": 4.0, "PSC_VELXY_P": 0.1}
    types = {"SYSID_THISMAV": 4, "WPNAV_SPEED": 9, "PSC_VELXY_P": 9}
    plain = parameters.format_parameters(values, "param")
    assert plain == "PSC_VELXY_P,0.1\nSYSID_THISMAV,4\nWPNAV_SPEED,30\n"
    text = parameters.format_parameters(values, "params", types=types, sysid=4, version="4.6.0")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert lines[1] == "4\t1\tSYSID_THISMAV\t4\t4"
    assert lines[2] == "4\t1\tWPNAV_SPEED\t30.000000000000000000\t9"
    for name, content in (("a.param", plain), ("a.params", text)):
        (tmp_path / name).write_text(content)
        assert parameters.read_parameters(tmp_path / name) == values


def test_mavproxy_reads_what_is_written(tmp_path):
    """With pymavlink's reader of parameter files."""
    mavparm = pytest.importorskip("pymavlink.mavparm")
    values = {"WPNAV_SPEED": 30.0, "PSC_VELXY_P": 0.1}
    path = tmp_path / "a.param"
    path.write_text(parameters.format_parameters(values, "param"))
    read = mavparm.MAVParmDict()
    assert read.load(str(path), check=False, mav=None)
    assert dict(read) == pytest.approx(values)


@pytest.mark.sitl
def test_a_real_autopilot_takes_the_parameters_and_gives_all(ardusub, tmp_path):
    from angler_mjx.cli.main import main

    (tmp_path / "mine.param").write_text("WPNAV_SPEED,30\n")
    out = tmp_path / "all.params"
    extra = ["--parameters", str(tmp_path / "mine.param"), "--ardusub", str(ardusub.path)]
    main(["sitl", "parameters", "--out", str(out), *extra])
    read = parameters.read_parameters(out)
    assert len(read) > 1000
    assert read["WPNAV_SPEED"] == 30.0
    assert read["FRAME_CONFIG"] == 2.0
