"""Results that never were, written once."""

import pytest

from angler_mjx.studies.benchmark.report import page, reading

from . import synthetic

FEW = {"planners": ("grid", "RRTConnect", "KPIECE1"), "teams": (1, 4, 8), "worlds": 12}


@pytest.fixture(scope="session")
def rows_and_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    return synthetic.write(folder, **FEW), folder


@pytest.fixture(scope="session")
def rows(rows_and_folder):
    return rows_and_folder[0]


@pytest.fixture(scope="session")
def results(rows_and_folder):
    return reading.read_results(rows_and_folder[1])


@pytest.fixture(scope="session")
def made(rows_and_folder):
    return page.write_report(rows_and_folder[1])
