"""Signals sent to this very process."""

import os
import signal

import pytest

from angler_mjx.teleop.signals import break_on_signal, stop_on_signal

ALL = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def send(number):
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", ALL)
def test_a_signal_asks_for_the_end_and_a_second_one_breaks_off(number):
    before = [signal.getsignal(one) for one in ALL]
    with stop_on_signal() as stop:
        assert not stop.requested
        send(number)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            send(number)
        stop.closing = True
        send(number)
    assert [signal.getsignal(one) for one in ALL] == before


@pytest.mark.parametrize("number", ALL)
def test_before_the_drive_a_signal_breaks_off(number):
    before = [signal.getsignal(one) for one in ALL]
    with break_on_signal() as interrupt:
        interrupt.check()
        with pytest.raises(KeyboardInterrupt):
            send(number)
        # Swallowed by somebody, it is raised again.
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()
    assert [signal.getsignal(one) for one in ALL] == before
