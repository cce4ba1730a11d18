"""Numbers in README and docs are those of the measurements they name: rows and results kept."""

import json
import re
from pathlib import Path

import pytest

from angler_mjx.robot.vehicles import library, properties
from angler_mjx.studies.speed import chart
from angler_mjx.studies.speed import rows as speed
from angler_mjx.studies.speed.compare import select_latest
from angler_mjx.testing.validation import validate

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results.jsonl"

REEF = {"workload": "reef_fleet", "worlds": 16384, "robots": 4, "devices": 1}
EIGHT = {"workload": "closed_loop_8", "worlds": 65536, "robots": 8, "devices": 1}
STATEMENTS = {
    "README, the table: mjx": (
        "README.md",
        r"while all move, (\S+) vehicle-steps/s with everything on",
        {**REEF, "engine": "mjx"},
    ),
    "performance, engines: fused": (
        "docs/explanation/performance.md",
        r"the demo's scenario runs at (\S+) vehicle-steps/s in 16,384 worlds",
        {**REEF, "engine": "fused"},
    ),
    "performance, engines: mjx": (
        "docs/explanation/performance.md",
        r"where mjx makes (\S+), and eight robots",
        {**REEF, "engine": "mjx"},
    ),
    "performance, engines: eight of a kind": (
        "docs/explanation/performance.md",
        r"eight robots of one kind at (\S+);",
        {**EIGHT, "engine": "fused"},
    ),
    "decision 3: mjx": (
        "docs/decisions/0003-mjx-engine.md",
        r"\*\*Measured\.\*\* (\S+) vehicle-steps/s on one H200 at 16,384 worlds",
        {**REEF, "engine": "mjx"},
    ),
}
"""Where a rate stands, and which row it is of: the latest of an H200 with these fields."""


@pytest.fixture(scope="module")
def rows():
    return select_latest(speed.read_rows(RESULTS))


@pytest.mark.parametrize("statement", STATEMENTS)
def test_a_rate_is_that_of_its_row(rows, statement):
    file, pattern, wanted = STATEMENTS[statement]
    found = re.findall(pattern, (ROOT / file).read_text())
    assert len(found) == 1, f"{file}: {pattern!r} is there {len(found)} times"
    wanted = {**wanted, "device": "NVIDIA H200"}
    matching = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    assert matching, f"no row of {wanted}"
    row = matching[-1]
    message = f"{file} says {found[0]}, the row of commit {row['commit']}: {row['median']:.3g}"
    assert found[0] == chart.format_rate(row["median"]), message


def test_rates_of_arms_are_those_of_their_rows(rows):
    text = (ROOT / "docs" / "reference" / "arms.md").read_text()
    found = re.findall(r"^\| ([\d,]+) \| (\d\.\d\de\d) \| (\S+ s) \|$", text, re.MULTILINE)
    measured = [
        (
            f"{row['worlds']:,}",
            f"{row['median']:.2e}".replace("+0", ""),
            f"{row['compile_s']:.1f} s",
        )
        for row in rows
        if (row["workload"], row["device"]) == ("dynamics_arm", "NVIDIA H200")
    ]
    assert found == measured
    rigid = {
        row["worlds"]: chart.format_rate(row["median"])
        for row in rows
        if (row["workload"], row["device"]) == ("dynamics", "NVIDIA H200")
    }
    assert f"make {rigid[65536]} in 65,536 worlds" in text


def test_several_devices_scale_as_said():
    """Four H200 did four times what one did, with the kernels of that day."""
    text = (ROOT / "docs" / "explanation" / "performance.md").read_text()
    assert "four H200 did four times what one did" in text
    rate = {
        row["devices"]: row["median"]
        for row in speed.read_rows(RESULTS)
        if row["workload"] == "closed_loop_8"
        and (row["worlds"], row["robots"], row["device"]) == (65536, 8, "NVIDIA H200")
        and row["kernels"] == "triton"
    }
    assert rate[4] / rate[1] == pytest.approx(4, rel=0.05)


def test_the_table_of_performance_is_that_of_the_rows():
    text = (ROOT / "docs" / "generated" / "performance.md").read_text()
    between = text.partition(chart.BEGIN)[2].partition(chart.END)[0]
    assert between.strip() == chart.format_table(RESULTS), (
        "write it again: "
        "angler bench --table benchmarks/results.jsonl --out docs/generated/performance.md"
    )


def test_the_page_of_validation_is_that_of_its_results_and_rows():
    """New rows of speed change it too: their rates stand there."""
    assert validate.find_page_faults(validate.open_checkout(ROOT)) == []


def stored(name):
    """A file of docs/validation."""
    return json.loads((ROOT / "docs" / "validation" / f"{name}.json").read_text())


SINGLE = stored("claims")
"""Measurements of one number or a few, with date, commit and command."""


LEVELS, WORLDS, ROBOTS = ("thrusters", "guided"), 8, 32
"""Where commands enter the autopilots, and the worlds and robots of the check at each."""


def _spot_check():
    """Numbers of README that the stored spot check holds, by where they stand in the text."""
    found = stored("spotcheck")
    other = {
        level: found["numbers"][f"{level}.recorded.other_outcome"]["value"] for level in LEVELS
    }
    apart = {level: found["numbers"][f"{level}.recorded.track_median"]["value"] for level in LEVELS}
    alike = {level: f"{ROBOTS - other[level]:.0f} of {ROBOTS}" for level in LEVELS}
    (firmware,) = re.findall(r"ArduSub (\S+), sha256", found["text"])
    return {
        "README, of all flights": (
            "README.md",
            r"In (\d+) flights of a batch run's plans on ArduSub processes \((\S+); (\d+) worlds "
            r"of (\d+) robots at each of two levels\) (\d+) of (\d+) robots end as in that run",
            (
                f"{len(LEVELS) * WORLDS}",
                firmware,
                f"{WORLDS}",
                f"{ROBOTS // WORLDS}",
                f"{2 * ROBOTS - sum(other.values()):.0f}",
                f"{2 * ROBOTS}",
            ),
        ),
        "README, thrusters": (
            "README.md",
            r"([\d.]+ cm) where our controllers drive the thrusters \((\d+ of \d+) outcomes\)",
            (f"{100 * apart['thrusters']:.1f} cm", alike["thrusters"]),
        ),
        "README, guided": (
            "README.md",
            r"([\d.]+ cm) where the firmware steers itself \(`guided`, (\d+ of \d+); ([\d-]+)\)",
            (f"{100 * apart['guided']:.0f} cm", alike["guided"], found["about"]["at_utc"][:10]),
        ),
        "sitl": (
            "docs/how_to/spotcheck.md",
            r"newest stored check \(([\d-]+), ArduSub (\S+), .*\): against what the run recorded "
            r"(\d+ of \d+)\srobots end the same way at `thrusters`, (\S+) m from its tracks, and "
            r"(\d+ of \d+) at `guided`, (\S+) m",
            (
                found["about"]["at_utc"][:10],
                firmware,
                alike["thrusters"],
                f"{apart['thrusters']:.3f}",
                alike["guided"],
                f"{apart['guided']:.3f}",
            ),
        ),
        "validation, guided": (
            "docs/generated/validation.md",
            r"\| guided \| recorded \| (\d+ of \d+) \| ([\d.]+),",
            (alike["guided"], f"{apart['guided']:.3f}"),
        ),
    }


def _single():
    """Numbers of README and docs that are stored by themselves."""
    large, demo = SINGLE["reef_fleet_65536"], SINGLE["demo_2_cores"]
    hold, lockstep = SINGLE["sitl_hold"], SINGLE["sitl_lockstep"]
    run, made = large["numbers"], demo["numbers"]
    after_s = made["total_s"] - made["install_s"]
    pace = [f"{hold['numbers'][key]:g}" for key in ("real_time_low", "real_time_high")]
    steps = [f"{lockstep['numbers'][key]:g}" for key in ("real_time_low", "real_time_high")]
    seconds = (str(run["simulate_s"]), str(run["compile_s"]))
    return {
        "README, a run of 65,536": (
            "README.md",
            r"On one H200, (\S+) robots in (\S+) reefs run to the end of their episodes in (\d+) "
            r"s, after (\d+) s of compiling \(([\d-]+)\)",
            (f"{run['robots']:,}", f"{run['worlds']:,}", *seconds, large["date"]),
        ),
        "validation, a run of 65,536": (
            "docs/explanation/validation.md",
            r"simulates (\S+) robots to the end of their episodes in (\d+) s after (\d+) s of\s"
            r"compiling \(([\d-]+)\);",
            (f"{run['robots']:,}", *seconds, large["date"]),
        ),
        "README, the demo": (
            "README.md",
            r"the demo's (\S+) robots take (\d+) s after installation, compilation and figures "
            r"included, in (\S+) GB \(([\d-]+)\)",
            (f"{made['robots']:,}", str(after_s), str(made["memory_gb"]), demo["date"]),
        ),
        "validation, the demo": (
            "docs/explanation/validation.md",
            r"took (\d+) s in a fresh clone with empty\scaches on 2 cores: (\d+) s of installing, "
            r"(\d+) s of compiling, (\d+) s of simulating, the rest figures\sand replay; (\S+) GB",
            tuple(
                str(made[key])
                for key in ("total_s", "install_s", "compile_s", "simulate_s", "memory_gb")
            ),
        ),
        "README, real autopilots": (
            "README.md",
            r"at (\S+) to (\S+) times real time on 2 CPU cores, logs and recording included \(the "
            r"lockstep alone, motors disarmed: (\S+) to (\S+); ([\d-]+)\)",
            (*pace, *steps, hold["date"]),
        ),
        "sitl, whole flights": (
            "docs/reference/sitl.md",
            r"four robots with guidance, MAVLink, logs and recording, goes (\S+) to (\S+) times",
            tuple(pace),
        ),
        "sitl, the lockstep": (
            "docs/reference/sitl.md",
            r"\n\| 4 \| (\S+) to (\S+) \| 92 to",
            tuple(steps),
        ),
    }


def _convergence():
    """The range of our scheme's error at 10 ms, moderate manoeuvres, in millimetres."""
    study = stored("validation")["studies"]["convergence"]
    numbers = study["numbers"]
    chosen = [
        10 * number["value"]
        for name, number in numbers.items()
        if name.startswith("moderate.") and name.endswith(".10_ms")
    ]
    return {
        "README, the discretisation": (
            "README.md",
            r"at 10 ms a vehicle is (\S+) to (\S+) mm from an adaptive eighth-order solution of "
            r"the same equations \(([\d-]+)\)",
            (f"{min(chosen):.1f}", f"{max(chosen):.1f}", study["about"]["at_utc"][:10]),
        )
    }


TEXTS = {**_spot_check(), **_single(), **_convergence()}
"""Page, pattern and what its groups have to be, by what is stored."""


@pytest.mark.parametrize("statement", TEXTS)
def test_a_text_states_what_is_stored(statement):
    file, pattern, wanted = TEXTS[statement]
    found = re.findall(pattern, (ROOT / file).read_text())
    assert len(found) == 1, f"{file}: {pattern!r} is there {len(found)} times"
    states = found[0] if isinstance(found[0], tuple) else (found[0],)
    assert states == wanted, f"{file} states {states}, stored is {wanted}"


@pytest.mark.parametrize("name", SINGLE)
def test_a_single_measurement_names_date_commit_and_command(name):
    row = SINGLE[name]
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", row["date"])
    assert re.fullmatch(r"[0-9a-f]{7,40}", row["commit"])
    assert row["device"]
    assert row["source"]
    assert row["command"].split()[0] in ("make", "angler", "python")


def test_every_number_of_the_table_is_held():
    """A row of README's table is matched by a claim: a new one needs a stored measurement."""
    text = (ROOT / "README.md").read_text()
    table = text[text.index("| claim |") : text.index("Published parameter sets")]
    patterns = [pattern for file, pattern, _ in (*TEXTS.values(), *STATEMENTS.values())]
    rows = [row for row in table.splitlines()[2:] if row]
    assert len(rows) == 5
    for row in rows:
        statement = row.split(" | ")[0]
        for pattern in patterns:
            statement = re.sub(pattern, "", statement)
        left = re.sub(r"\b(?:H200|2 CPU cores)\b", "", statement)
        assert not re.findall(r"\d", left), f"README states what nothing stores: {left}"


def test_sets_of_a_vehicle_differ_in_top_speed_as_said():
    (message,) = re.findall(
        r"differ by a factor of (\S+) in top speed", (ROOT / "README.md").read_text()
    )
    ratios = []
    for config in map(library.load_vehicle, library.list_rovs()):
        tops = [
            properties.describe_vehicle(config, name, 16.0).terminal_speed_mps[0]
            for name in config.published_sets
        ]
        ratios.append(max(tops) / min(tops))
    assert f"{max(ratios):.1f}" == message
