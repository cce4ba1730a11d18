"""Gains that nobody sets are those that docs/generated/control.md flew and lists."""

import dataclasses
import re
from pathlib import Path

import pytest

from angler_mjx.robot.control import stages

PAGE = Path(__file__).parents[4] / "docs" / "generated" / "control.md"


def listed(controller):
    """Gains of each stage of a controller as its section lists them."""
    sections = re.split(r"^## ", PAGE.read_text(), flags=re.MULTILINE)
    (section,) = [text for text in sections if text.startswith(f"{controller}\n")]
    (line,) = re.findall(r"^Gains\. (.*)\.$", section, flags=re.MULTILINE)
    found = {}
    for part in line.split("; "):
        name, numbers = re.fullmatch(r"`(\w+)`: (.*)", part).groups()
        pairs = (pair.split(" ") for pair in numbers.split(", "))
        found[name] = {gain: float(number) for gain, number in pairs}
    return found


@pytest.mark.parametrize("controller", stages.CONTROLLERS)
def test_default_gains_are_those_of_the_document(controller):
    names = stages.CONTROLLERS[controller]
    _, gains = stages.build_stack(names, {})
    ours = {
        name: dataclasses.asdict(one) for name, one in zip(names, gains, strict=True) if one != ()
    }
    assert {name: numbers for name, numbers in ours.items() if numbers} == listed(controller)
