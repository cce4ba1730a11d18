"""Every command line of README and docs runs to its end: one of each verb daily, all at night.

Commands of `angler` share this process, and simulators of one scenario share their programs.
"""

import pytest

from angler_mjx.simulator.simulator import Simulator
from angler_mjx.speed.measured import compilation

from . import printed, running


def _lines():
    """Commands to be run, each in its size of tests once: of tests daily and of others at night."""
    alike = {}
    for command in (*running.DAILY, *printed.commands(), *running.NIGHTLY):
        if running.reason_to_skip(command) is None:
            alike.setdefault((command.program, *running.small(command)), command)
    daily = {}
    for command in alike.values():
        if command.program == "angler":
            daily.setdefault(command.verb, command)
    nightly = pytest.mark.nightly(by="the line of its verb that is run daily; test_parsed.py")
    return [
        pytest.param(command, marks=() if command in daily.values() else nightly, id=command.line)
        for command in alike.values()
    ]


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    return running.Workshop(tmp_path_factory.mktemp("commands"))


@pytest.fixture(scope="module", autouse=True)
def _shared_programs():
    """Give simulators of one scenario, tile and planner the programs that the first compiled."""
    made, begin = {}, Simulator.__init__

    def share(self, scenario, **options):
        options = {name: value for name, value in options.items() if value is not None}
        options = {"devices": 1, "tile": scenario.tile} | options
        programs = scenario.model_copy(update={"name": "", "description": "", "worlds": 1})
        key = (programs.model_dump_json(exclude={"store", "seed"}), repr(sorted(options.items())))
        if "policy" in options or scenario.planner.name not in ("grid", "priority"):
            begin(self, scenario, **options)
        elif key not in made:
            begin(self, scenario, **options)
            made[key] = self
        else:
            self.__dict__ = made[key].__dict__  # what one compiles, all have
            self.scenario = scenario

    # What measures compiling compiles: it has simulators of its own.
    fresh = type("Fresh", (Simulator,), {"__init__": begin})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulator, "__init__", share)
        patch.setattr(compilation, "Simulator", fresh)
        yield


@pytest.mark.parametrize("command", _lines())
def test_a_printed_command_runs_to_its_end(command, workshop):
    workshop.run(command)
