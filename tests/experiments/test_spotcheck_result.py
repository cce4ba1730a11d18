"""A folder of a spot check becomes a result of the page."""

import json

import pytest

from angler_experiments import spotcheck_result
from angler_mjx.errors import ConfigError
from angler_mjx.testing.validation.host import describe_host
from angler_mjx.testing.validation.results import TermResult, read_model

ROWS = """\
level,robots,against,world,robot,outcome,other_outcome,track_rms_m,path_rms_m,endpoint_m
thrusters,2,recorded,8,0,reached,reached,0.01,0.005,0.02
thrusters,2,recorded,8,1,reached,timeout,0.03,0.015,5.0
guided,2,recorded,8,0,reached,reached,0.2,0.1,0.1
"""


@pytest.fixture
def folder(tmp_path):
    table = {
        "provenance": {**describe_host(), "command": "angler spotcheck"},
        "asked": {"run": "runs/reef", "ardusub": "4.6"},
    }
    (tmp_path / "spotcheck.json").write_text(json.dumps(table))
    (tmp_path / "gaps.csv").write_text(ROWS)
    return tmp_path


def test_numbers_and_table(folder):
    out = folder / "result.json"
    spotcheck_result.main(folder, out)
    result = read_model(TermResult, out)
    assert (
        "| thrusters | recorded | 1 of 2 | 0.020, 0.03 | 0.010, 0.01 | 0.020, 0.02 |" in result.text
    )
    assert "| guided | recorded | 1 of 1 |" in result.text
    assert "ArduSub 4.6" in result.text
    assert result.numbers["thrusters.recorded.other_outcome"].value == 1.0
    assert result.numbers["guided.recorded.track_median"].value == pytest.approx(0.2)


def test_what_is_no_spot_check_is_named(folder):
    (folder / "gaps.csv").write_text(ROWS.splitlines()[0])
    with pytest.raises(ConfigError, match=r"gaps\.csv"):
        spotcheck_result.main(folder, folder / "result.json")
    (folder / "spotcheck.json").write_text("{}")
    with pytest.raises(ConfigError, match=r"spotcheck\.json"):
        spotcheck_result.main(folder, folder / "result.json")
