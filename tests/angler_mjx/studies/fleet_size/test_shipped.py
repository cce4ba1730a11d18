"""The studies that ship can be asked, for every size and condition."""

import re
from pathlib import Path

import pytest

from angler_mjx.cli.studies.fleet_size import fleet_size
from angler_mjx.shipped import list_shipped
from angler_mjx.studies.fleet_size import conditions

FILES = tuple(list_shipped("angler_mjx.studies.fleet_size").values())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_size_can_be_flown(path):
    study = conditions.read_study(path)
    assert study.config.name == path.stem
    for condition in study.conditions:
        for size in study.config.first_sizes():
            scenario = study.scenario(condition, size)
            assert len(scenario.members()) == size
            assert scenario.time.horizon_s >= study.config.deadline_s


def test_tasks_are_asked_in_currents_with_breakdowns_and_acoustics():
    for name in ("survey_reef", "delivery_corridor"):
        study = conditions.read_study(next(path for path in FILES if path.stem == name))
        made = {one.name: study.scenario(one, 8) for one in study.conditions}
        speeds = [
            made[name].randomise.current[0] * 0.5 for name in ("still water", "0.2 m/s", "0.5 m/s")
        ]
        assert speeds == pytest.approx([0.0, 0.2, 0.5])
        for scenario in made.values():
            east, north, up = scenario.world.currents[0].velocity_mps
            assert (east**2 + north**2 + up**2) ** 0.5 == pytest.approx(0.5)
        assert made["one in five breaks down"].breakdowns.fraction == 0.2
        assert made["acoustic"].acoustics.model == "budget"
        assert study.sizes == tuple(range(1, 65))
        smoke = conditions.read_study(Path(study.source), smoke=True)
        assert (smoke.sizes, smoke.config.budget.max_worlds) == ((1, 8), 4)


def test_help_and_page_name_every_study():
    names = {path.stem for path in FILES}
    listed = re.search(r"Name of a shipped study \((.*?)\)", " ".join(fleet_size.__doc__.split()))
    assert set(listed[1].split(", ")) == names
    page = Path(__file__).parents[4] / "docs" / "how_to" / "fleet_size.md"
    rows = re.findall(r"^\| `(\w+)\.toml` \|", page.read_text(encoding="utf-8"), re.M)
    assert sorted(rows) == sorted(names)
