"""The viewer's window: what is said where it cannot be opened, and that it is one of its own."""

import sys

import pytest

from angler_mjx.errors import UnsupportedError
from angler_mjx.report.viewing import viewer_window

LISTENS = """
import socket, sys, time
place = (sys.argv[sys.argv.index("--bind") + 1], int(sys.argv[sys.argv.index("--port") + 1]))
with socket.create_server(place) as server:
    print("listening"); sys.stdout.flush()
    {then}
"""


class Connected:
    """Stands for a recording."""

    def __init__(self):
        self.urls, self.active = [], []

    def connect_grpc(self, url):
        self.urls.append(url)

    def send_blueprint(self, blueprint, make_active, make_default):
        # What is only the default loses against what the viewer kept of another recording.
        self.active += [blueprint] * make_active


def _viewer(then):
    return [sys.executable, "-c", LISTENS.format(then=then)]


@pytest.mark.parametrize(
    ("viewer", "reason"),
    [
        ([sys.executable, "-c", "raise SystemExit('no such program')"], "no such program"),
        # So it ends where DISPLAY names a screen that is not there.
        (_viewer("server.accept(); raise SystemExit('Error: no screen')"), "Error: no screen"),
    ],
)
def test_a_viewer_that_ends_at_once_is_told_with_its_last_words(viewer, reason):
    recording = Connected()
    with pytest.raises(UnsupportedError, match=f"cannot be started: {reason}"):
        viewer_window.open_viewer(recording, None, viewer)
    assert recording.urls == []


def test_each_recording_has_a_viewer_of_its_own():
    recording = Connected()
    for blueprint in "ab":
        viewer_window.open_viewer(recording, blueprint, _viewer("time.sleep(4)"))
    one, other = recording.urls
    assert one != other
    assert recording.active == ["a", "b"]
    assert one.startswith("rerun+http://127.0.0.1:")
