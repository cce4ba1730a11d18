"""Every command line of README and docs runs to its end: one of each verb daily, all at night.

Commands of `angler` share this process, and with it compiled programs.
"""

import pytest

from tests.opengl import reason_without

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


@pytest.mark.parametrize("command", _lines())
def test_a_printed_command_runs_to_its_end(command, workshop):
    if command.verb == "angler replay" and (reason := reason_without()):
        pytest.skip(reason)
    workshop.run(command)
