"""Cards and files of plans as others write them, and as they break."""

import os
from dataclasses import replace

import numpy as np
import pytest
import zarr
from pydantic import ValidationError

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import problem_sets, submission, submitted_plans
from angler_mjx.runs.storage.plans.read import open_plans

from .submitting import straight_lines, write_card, write_plans

NAME = "open-still-known-01"


@pytest.fixture
def read(tmp_path, problems, sets, manifest):
    """Change straight lines, write them, and read them as the check does."""

    def read(change=lambda arrays, attributes: None):
        arrays, attributes = straight_lines(problems, NAME)
        change(arrays, attributes)
        write_plans(tmp_path, NAME, arrays, attributes)
        path = tmp_path / "plans" / f"{NAME}.zarr"
        return submitted_plans.read_plans(path, sets[NAME], manifest.find(NAME), seed(problems), 64)

    return read


def seed(problems):
    return zarr.open_group(problems / f"{NAME}.zarr", mode="r").attrs["seed"]


def test_plans_are_read_as_they_were_written(read, problems):
    rows = read()
    arrays, _ = straight_lines(problems, NAME)
    assert list(rows.faults) == ["", ""]
    for name in ("points", "time_s", "position_m"):
        np.testing.assert_array_equal(rows.arrays[name], arrays[name])
    np.testing.assert_allclose(rows.planning_s, 0.01)


def wrong_digest(arrays, attributes):
    attributes["digest"] = "0" * 64


def other_seed(arrays, attributes):
    """Known and observed problems of a kind differ in their seed alone."""
    attributes["seed"] += 1


def no_seed(arrays, attributes):
    del attributes["seed"]


def no_schema(arrays, attributes):
    del attributes["schema"]


def edited_hash(arrays, attributes):
    attributes["sha256"] = ["0" * 64, "1" * 64]


def one_world(arrays, attributes):
    for name in arrays:
        arrays[name] = arrays[name][:1]


def no_times(arrays, attributes):
    del arrays["time_s"]


def planar(arrays, attributes):
    arrays["position_m"] = arrays["position_m"][..., :2]


def huge(arrays, attributes):
    for name in ("time_s", "position_m"):
        arrays[name] = np.zeros((*arrays[name].shape[:2], 1025, *arrays[name].shape[3:]), "f4")


def velocity_alone(arrays, attributes):
    arrays["velocity"] = np.zeros((*arrays["time_s"].shape, 4), "f4")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (wrong_digest, "digest is '000000000000', that of the problems is"),
        (other_seed, "that of the problems: its plans are of others"),
        (no_seed, "seed is missing or not "),
        (no_schema, "holds no plans of schema version 1"),
        (edited_hash, "sha256 differs from that of the frozen problems"),
        (one_world, "must be"),
        (no_times, "time_s must be"),
        (planar, "position_m: has the shape"),
        (huge, "2 to 1024 points"),
        (velocity_alone, "without yaw_rad"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_file_that_cannot_be_used_fails_its_problems_with_the_reason(read, change, reason):
    rows = read(change)
    assert len(rows.faults) == 2
    assert all(reason in fault for fault in rows.faults)
    assert not rows.arrays["points"].any()


BENT = (
    "robot 0: path with velocities or of a degree above 1; paths lead straight from point to point"
)


@pytest.mark.parametrize(
    ("degree", "faults"),
    [
        (None, [BENT, BENT]),  # as files without degrees are flown
        ([[1, 1], [1, 1]], ["", ""]),
        ([[1, 1], [3, 1]], ["", BENT]),
        ([[2, 1], [1, 1]], [BENT, ""]),
        ([[1, 3], [1, 1]], ["", ""]),  # no segment begins at the last point
    ],
)
def test_a_path_that_bends_fails_its_problem_alone(read, degree, faults):
    """It would be faster between its points than the cruise speed."""

    def bend(arrays, attributes):
        shape = arrays["time_s"].shape
        arrays["yaw_rad"] = np.zeros(shape, "f4")
        arrays["velocity"] = np.zeros((*shape, 4), "f4")
        arrays["acceleration"] = np.zeros((*shape, 4), "f4")
        if degree is not None:
            arrays["degree"] = np.array(degree, "i4")[:, None]

    rows = read(bend)
    assert list(rows.faults) == faults
    assert rows.arrays["points"].tolist() == [[0 if fault else 2] for fault in faults]
    assert set(rows.arrays) == {"points", "time_s", "position_m", "yaw_rad"}


@pytest.mark.parametrize("kind", ["link", "linked file", "pipe"])
def test_links_and_pipes_in_a_file_of_plans_fail_its_problems(
    tmp_path, problems, sets, manifest, kind
):
    """They could lead to files of the judge, or be read for ever."""
    write_plans(tmp_path / "s", NAME, *straight_lines(problems, NAME))
    path = tmp_path / "s" / "plans" / f"{NAME}.zarr"
    if kind == "link":
        path.rename(tmp_path / "elsewhere")
        path.symlink_to(tmp_path / "elsewhere")
    else:
        part = path / "time_s" / "zarr.json"
        part.rename(tmp_path / "elsewhere")
        part.symlink_to(tmp_path / "elsewhere") if kind == "linked file" else os.mkfifo(part)
    rows = submitted_plans.read_plans(path, sets[NAME], manifest.find(NAME), seed(problems), 64)
    name = f"{NAME}.zarr" if kind == "link" else f"{NAME}.zarr/time_s/zarr.json"
    assert list(rows.faults) == [f"{name} is a link, pipe or device"] * 2


def test_rows_are_stored_with_their_times_and_faults(tmp_path, read):
    rows = replace(read(), faults=["", "was late"], planning_s=np.array([0.5, np.nan]))
    submitted_plans.store_rows(tmp_path / "rows.npz", rows)
    loaded = submitted_plans.load_rows(tmp_path / "rows.npz")
    assert loaded.faults == ["", "was late"]
    np.testing.assert_array_equal(loaded.planning_s, rows.planning_s)
    assert loaded.arrays.keys() == rows.arrays.keys()
    for name, values in rows.arrays.items():
        np.testing.assert_array_equal(loaded.arrays[name], values)
    assert [path.name for path in tmp_path.glob("*.npz")] == ["rows.npz"]


def test_plans_are_flown_with_the_cruise_speed_as_limit_over_ground(
    tmp_path, read, benchmark, sets
):
    scenario = problem_sets.build_scenario(benchmark, sets[NAME], 1)
    submitted_plans.write_plans(tmp_path / "plans.zarr", scenario, read())
    assert open_plans(tmp_path / "plans.zarr", scenario).limits_ground_speed


def test_a_file_that_is_missing_or_no_file_fails_its_problems(tmp_path, sets, manifest):
    path = tmp_path / "plans" / f"{NAME}.zarr"
    arguments = (sets[NAME], manifest.find(NAME), 1, 64)
    assert set(submitted_plans.read_plans(path, *arguments).faults) == {f"{NAME}.zarr is missing"}
    path.mkdir(parents=True)
    (path / "zarr.json").write_text("{]")
    faults = submitted_plans.read_plans(path, *arguments).faults
    assert len(faults) == 2
    assert all(f"{NAME}.zarr" in fault for fault in faults)


def test_a_path_that_is_too_long_fails_its_problem_alone(read):
    def long(arrays, attributes):
        for name in ("time_s", "position_m"):
            arrays[name] = np.concatenate([arrays[name]] * 40, axis=2)
        arrays["points"][1, 0] = 65

    rows = read(long)
    assert list(rows.faults) == ["", "robot 0: path of 65 points, at most 64"]
    assert rows.arrays["points"].tolist() == [[2], [0]]
    assert rows.arrays["time_s"].shape == (2, 1, 64)


def test_a_damaged_chunk_fails_its_problem_alone(tmp_path, problems, sets, manifest):
    arrays, attributes = straight_lines(problems, NAME)
    times = arrays.pop("time_s")
    write_plans(tmp_path, NAME, arrays, attributes)
    path = tmp_path / "plans" / f"{NAME}.zarr"
    zarr.open_group(path).create_array("time_s", data=times, chunks=(1, 1, 2), compressors=None)
    (path / "time_s/c/1/0/0").write_bytes(b"cut")
    rows = submitted_plans.read_plans(path, sets[NAME], manifest.find(NAME), seed(problems), 64)
    assert rows.faults[0] == ""
    assert rows.faults[1].startswith(f"{NAME}.zarr/time_s: cannot be read")
    np.testing.assert_array_equal(rows.arrays["time_s"][0], times[0])


@pytest.mark.parametrize(
    ("reasons", "notes"),
    [
        (["walled\x1b in"], {(1, 0): "walled in"}),
        (["x" * 5000], {(1, 0): "x" * 200}),
        ([], {}),
        ("none", {}),
        (None, {}),
    ],
)
def test_reasons_of_a_file_are_read_without_trust(read, reasons, notes):
    def change(arrays, attributes):
        arrays["reason"] = np.array([[-1], [0]], "i4")
        attributes["reasons"] = reasons

    rows = read(change)
    assert rows.notes == notes
    assert list(rows.faults) == ["", ""]


@pytest.mark.parametrize("seconds", [-1.0, np.inf])
def test_a_planning_time_that_cannot_be_fails_its_problem(read, seconds):
    def change(arrays, attributes):
        arrays["planning_s"][0] = seconds

    assert list(read(change).faults) == [f"planning_s is {seconds:g}", ""]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("ANGLER-1 1.0", "ANGLER-1 0.9"), "this program judges 'ANGLER-1 1.0'"),
        (('kind = "plans"', 'kind = "program"'), r"the table \[program\] must be there"),
        (('kind = "plans"', 'kind = "magic"'), "kind"),
        (("machine", "machin"), "machin"),
        (('kind = "plans"', 'kind = "plans"\nurl = "javascript:alert(1)"'), "url"),
        (('["open-still', '["opn-still'), "card.toml: sets: "),
    ],
)
def test_a_card_that_cannot_be_understood_is_refused(tmp_path, benchmark, change, message):
    write_card(tmp_path, [NAME], change=change)
    with pytest.raises(ConfigError, match=message):
        submission.select_entered(benchmark, submission.read_card(tmp_path), tmp_path)


def test_a_folder_without_a_card_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"card\.toml is missing"):
        submission.read_card(tmp_path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            'image = "../image.tar"',
            r"card\.toml: .*\s+program\.image = '\.\./image\.tar': must be the name of a tar file",
        ),
        ('image = "/image.tar"', "in the submission's folder, such as 'image.tar'"),
        ('image = "a/image.tar"', "such as 'image.tar'"),
        ('image = ".."', "program.image = '..': must be the name"),
        ('image = ""', "program.image = '': must be the name"),
        ('environment = { "A=B" = "c" }', "program.environment.*A=B"),
        ('environment = { A = "a\\u0000b" }', "program.environment.A"),
        ("environment = { A = 1 }", "program.environment.A"),
    ],
)
def test_an_image_or_environment_that_cannot_be_is_refused(tmp_path, line, message):
    write_card(tmp_path, [NAME], kind=('kind = "plans"', 'kind = "program"'))
    with (tmp_path / "card.toml").open("a") as file:
        file.write(f'[program]\ncommand = ["./a"]\n{line}\n')
    with pytest.raises(ConfigError, match=message):
        submission.read_card(tmp_path)


@pytest.mark.parametrize("part", ["planner", "policy"])
def test_no_code_of_a_card_runs_in_the_judges_process(tmp_path, part):
    code = tmp_path / "code.py"
    code.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n\nclass Planner:\n    pass\n")
    (tmp_path / "card.toml").write_text(
        'schema_version = 1\nbenchmark = "ANGLER-1 1.0"\nname = "a"\nkind = "in_flight"\n'
        f'[in_flight]\n{part} = {{ name = "{code}:Planner" }}\n'
        + ('policy = { name = "mppi" }\n' if part == "planner" else "")
    )
    with pytest.raises(ConfigError, match=rf"in_flight\.{part}: name = .*is a class of a file"):
        submission.read_card(tmp_path)
    assert not (tmp_path / "ran").exists()


def test_a_card_with_a_table_of_another_kind_is_refused(tmp_path):
    write_card(tmp_path, [NAME])
    with (tmp_path / "card.toml").open("a") as file:
        file.write('[in_flight]\npolicy = { name = "mppi" }\n')
    with pytest.raises(ConfigError, match=r"the table \[in_flight\]"):
        submission.read_card(tmp_path)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "commands nothing in flight"),
        ({"planner": {"name": "RRTConnect"}}, "commands nothing in flight"),
        ({"planner": {"name": "grid", "replan_hz": 0.0}}, "commands nothing in flight"),
        ({"planner": {"name": "grid", "replan_hz": 1e-4}}, "replan_hz of at least 0.1"),
        ({"policy": {"name": "none"}, "planner": {"name": "grid"}}, "commands nothing in flight"),
        (
            {"planner": {"replan_hz": 1.0, "deadline_s": 86400.0}},
            "deadline_s is given by the bench",
        ),
        ({"policy": {"name": "mppi"}, "planner": {"points": 512}}, "points is given by the bench"),
    ],
)
def test_plans_made_before_the_flight_do_not_enter_in_flight(table, message):
    """Nothing would limit the time of their planning."""
    with pytest.raises(ValidationError, match=message):
        submission.InFlightConfig(**table)
    flown = submission.InFlightConfig(planner={"name": "grid", "replan_hz": 1.0})
    assert flown.planner["replan_hz"] == 1.0
