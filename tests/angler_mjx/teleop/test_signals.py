"""Signals sent to this very process."""

import os
import signal

import pytest

from angler_mjx.teleop.signals import breakable, stoppable

ALL = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def send(number):
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", ALL)
def test_a_signal_asks_for_the_end_and_a_second_one_breaks_off(number):
    before = [signal.getsignal(one) for one in ALL]
    with stoppable() as stop:
        assert not stop.asked
        send(number)
        assert stop.asked
        with pytest.raises(KeyboardInterrupt):
            send(number)
        stop.closing = True
        send(number)
    assert [signal.getsignal(one) for one in ALL] == before


@pytest.mark.parametrize("number", ALL)
def test_before_the_drive_a_signal_breaks_off(number):
    before = [signal.getsignal(one) for one in ALL]
    with breakable() as interrupt:
        interrupt.check()
        with pytest.raises(KeyboardInterrupt):
            send(number)
        # Swallowed by somebody, it is raised again.
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()
    assert [signal.getsignal(one) for one in ALL] == before
