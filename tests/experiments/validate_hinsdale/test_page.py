"""Numbers of the page on real water are those of the committed results."""

import json
import re
from pathlib import Path

import pytest

from angler_experiments.validate_hinsdale import page

ROOT = Path(__file__).parents[3]
IDENTIFIED = "hinsdale2023_identified"


@pytest.fixture(scope="module")
def results():
    return json.loads((ROOT / "docs" / "validation" / "hinsdale.json").read_text())


@pytest.fixture(scope="module")
def text():
    return (ROOT / "docs" / "explanation" / "real_water.md").read_text()


@pytest.mark.parametrize("name", ["medians", "coverage", "horizons", "parameters"])
def test_tables_are_those_of_the_results(results, text, name):
    assert page.format_tables(results)[name] in text


def test_fleet_sizes_are_those_of_the_study(text):
    study = json.loads((ROOT / "docs" / "fleet_size" / "survey_sets.json").read_text())
    assert page.format_fleet_sizes(study) in text
    assert _numbers(text, r"([\d,]+) worlds on two CPU cores") == [study["worlds"]]
    energy = [
        row["energy_j"] / 1000.0
        for x in study["conditions"]
        for row in x["sizes"]
        if row["size"] == 6
    ]
    low, high = _numbers(text, r"from (\d+) to (\d+) kJ")
    assert [round(min(energy)), round(max(energy))] == [low, high]


def _numbers(text, pattern):
    """Return the numbers of the one place where a pattern matches, line breaks as blanks."""
    matches = re.findall(pattern, " ".join(text.split()))
    assert len(matches) == 1, f"{pattern!r} matches {len(matches)} times"
    match = matches[0]
    return [float(x.replace(",", "")) for x in ((match,) if isinstance(match, str) else match)]


def test_recordings_are_counted_as_stated(results, text):
    runs = [run for run in results["runs"].values() if "copy_of" not in run]
    halves = [sum(run["half"] == half for run in runs) for half in ("training", "test")]
    assert _numbers(text, r"\*\*(\d+) recordings\*\*") == [len(runs)]
    assert _numbers(text, r"in both halves: (\d+) runs identify, (\d+) judge") == halves
    counts = [sum(run[key] for run in runs) for key in ("masked", "frames", "swaps", "small_steps")]
    pattern = r"(\d+) of ([\d,]+) frames within (\d+) marker swaps. (\d+) smaller"
    assert _numbers(text, pattern) == counts


def test_errors_in_words_are_those_of_the_results(results, text):
    medians = results["medians"]["test"]
    best, authors = medians[IDENTIFIED], medians["hinsdale2023_authors"]
    (stated,) = _numbers(text, r"The errors are (\d+) % below those of the authors")
    for key in ("roll", "pitch"):
        assert 100.0 * (1.0 - best[key] / authors[key]) == pytest.approx(stated, abs=1.0)
    statics, better = medians["balance_identified"], results["better"]["balance_identified"]
    wanted = [statics["roll"], statics["pitch"], better["roll"], better["pitch"], better["runs"]]
    pattern = (
        r"errs by ([\d.]+) and ([\d.]+) rad; the simulation is better on (\d+) and (\d+) of (\d+)"
    )
    assert _numbers(text, pattern) == pytest.approx(wanted, abs=6e-5)
    heave = [medians["persistence"]["heave"], best["heave"]]
    pattern = r"first second errs by ([\d.]+) m, the identified set by ([\d.]+) m"
    assert _numbers(text, pattern) == pytest.approx(heave, abs=6e-5)
    yaw = [best["yaw"], medians["constant"]["yaw"], best["drift_end"]]
    pattern = r"yaw errs by ([\d.]+) rad, a constant by ([\d.]+) rad; drift after 10 s by ([\d.]+)"
    assert _numbers(text, pattern) == pytest.approx(yaw, abs=6e-4)
    imu = [
        medians[name][key] for name in (IDENTIFIED, "balance") for key in ("imu_roll", "imu_pitch")
    ]
    pattern = r"are ([\d.]+) rad in roll and ([\d.]+) in pitch \(balance: ([\d.]+) and ([\d.]+)\)"
    assert _numbers(text, pattern) == pytest.approx(imu, abs=6e-5)


def test_bad_runs_are_as_bad_as_stated(results, text):
    scores = results["scores"][IDENTIFIED]
    depth = [-scores[f"traj_alt_008-{i}"]["heave_end"] for i in (1, 0)]
    pattern = r"is ([\d.]+) m too low after 10 s \(`traj_alt_008-0`: ([\d.]+) m\)"
    assert _numbers(text, pattern) == pytest.approx(depth, abs=6e-3)
    stretched = [scores[f"traj_alt_{i}"]["roll"] for i in ("008-1", "011-0", "011-1")]
    balance = [
        results["scores"]["balance"][f"traj_alt_{i}"]["roll"] for i in ("008-1", "011-0", "011-1")
    ]
    wanted = [min(stretched), max(stretched), min(balance), max(balance)]
    balance_pattern = r"where the balance with the authors' weights has ([\d.]+) to ([\d.]+)\."
    pattern = rf"([\d.]+) to ([\d.]+) rad, {balance_pattern}"
    assert _numbers(text, pattern) == pytest.approx(wanted, abs=6e-4)


def test_directions_are_counted_as_stated(results, text):
    variances = results["identification"]["posterior_variances"]
    stated = _numbers(
        text,
        r"(\d+) of (\d+) directions keep more than half of their prior variance and (\d+) less",
    )
    assert stated == [
        sum(v > 0.5 for v in variances),
        len(variances),
        sum(v < 0.1 for v in variances),
    ]
    (windows,) = _numbers(text, r"The same on (\d+) windows")
    assert windows == results["horizons"]["windows"]
