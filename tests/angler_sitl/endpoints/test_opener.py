"""Confirmation before motors turn."""

import pytest

from angler_mjx.errors import ConfigError
from angler_sitl.endpoints.opener import confirm_arming


@pytest.mark.parametrize("answer", ["arm\n", "ARM\n", "  arm  \n"])
def test_the_word_arms(answer):
    reports = []
    confirm_arming(2, reports.append, lambda: answer)
    assert "the motors of 2 vehicles will turn" in reports[0]
    assert "type arm" in reports[0]


@pytest.mark.parametrize("answer", ["", "\n", "y\n", "yes\n", "disarm\n", "arm all\n"])
def test_anything_else_does_not(answer):
    with pytest.raises(ConfigError, match="not confirmed"):
        confirm_arming(1, lambda _: None, lambda: answer)
