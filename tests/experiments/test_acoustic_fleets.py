"""The figure of what modems cost a fleet, of the study that docs/reference/acoustics.md shows."""

from pathlib import Path

import pytest

from angler_experiments.acoustics import fleets
from angler_mjx.errors import ConfigError

STUDY = Path(__file__).parents[2] / "docs" / "fleet_size" / "survey_reef.json"


def test_the_shown_study_says_what_its_page_does() -> None:
    """Six robots are enough where all know all and too few by modem; many touch each other."""
    perfect, heard = (
        {size["size"]: size for size in sizes}
        for sizes in fleets.read_conditions(STUDY, ("still water", "acoustic"))
    )
    assert perfect[6]["low"] >= 0.95
    assert heard[6]["high"] < 0.95 <= heard[8]["low"]
    assert perfect[64]["lost_per_robot"] < 0.001
    # "of 16, 32 and 64 robots 1, 8 and 37 % are lost"
    lost = [heard[size]["lost_per_robot"] for size in (16, 32, 64)]
    assert lost == pytest.approx([0.01, 0.08, 0.37], abs=0.005)


def test_a_condition_that_was_not_flown_is_refused_and_the_others_named() -> None:
    with pytest.raises(ConfigError, match=r"survey_reef.json: no condition 'loud'; it has 'still"):
        fleets.read_conditions(STUDY, ("still water", "loud"))


def test_a_file_that_is_no_study_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "study.json"
    other.write_text("[1, 2]")
    with pytest.raises(ConfigError, match=r"study.json: is no study.json of angler study"):
        fleets.read_conditions(other, ("still water", "acoustic"))


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    both = fleets.read_conditions(STUDY, ("still water", "acoustic"))
    fleets.plot_conditions(both, ("known", "heard"), tmp_path / "both.png")
    assert (tmp_path / "both.png").stat().st_size > 5_000
