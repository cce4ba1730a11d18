"""Upload of missions: what an autopilot receives, and what happens when it refuses or is silent."""

import socket

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import RunError
from angler_sitl.wire.link import MavlinkLink
from angler_sitl.wire.mission_upload import MissionUpload, UploadItem

from .test_link import Far

ITEMS = [
    UploadItem(
        command=16,
        frame=3,
        parameters=(float(i), 0.0, 0.0, 0.0),
        latitude_deg=47.6 + 1e-5 * i,
        longitude_deg=-122.3,
        altitude_m=-float(i),
    )
    for i in range(3)
]


@pytest.fixture
def ends():
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.bind(("127.0.0.1", 0))
    far = Far(bound.getsockname())
    link = MavlinkLink(bound, name="robot_0", sysid=3)
    far.beat()
    link.receive(0.0)
    yield link, far
    bound.close()
    far.socket.close()


def request(far, number, kind=dialect.MAVLink_mission_request_int_message):
    far.say(kind(255, 190, number))


def test_items_are_sent_as_they_are_requested(ends):
    link, far = ends
    upload, time_s = MissionUpload(link, ITEMS), 0.0
    assert not upload.advance(time_s)
    (count,) = far.hear()
    assert (count.get_type(), count.count) == ("MISSION_COUNT", 3)
    # Of the old kind too, one twice, as after a lost packet.
    for number, kind in ((0, None), (1, None), (1, None), (2, "old")):
        old = dialect.MAVLink_mission_request_message
        request(far, number, *([old] if kind else []))
        time_s += 0.05
        link.receive(time_s)
        link.latest.pop("MISSION_REQUEST_INT" if kind else "MISSION_REQUEST", None)
        assert not upload.advance(time_s)
        (item,) = far.hear()
        assert item.get_type() == "MISSION_ITEM_INT"
        assert (item.seq, item.frame, item.command) == (number, 3, 16)
        assert (item.param1, item.z) == (float(number), -float(number))
        assert (item.x, item.y) == (round((47.6 + 1e-5 * number) * 1e7), -1223000000)
    far.say(dialect.MAVLink_mission_ack_message(255, 190, 0))
    link.receive(time_s)
    assert upload.advance(time_s)


def test_the_count_is_repeated_until_it_is_heard(ends):
    link, far = ends
    upload = MissionUpload(link, ITEMS)
    upload.advance(0.0)
    far.hear()
    upload.advance(1.0)
    far.hears_nothing()
    upload.advance(2.5)
    assert far.hear()[0].get_type() == "MISSION_COUNT"


def test_a_refusal_names_the_item_and_its_command(ends):
    link, far = ends
    upload = MissionUpload(link, ITEMS)
    upload.advance(0.0)
    request(far, 2)
    link.receive(0.1)
    upload.advance(0.1)
    far.say(dialect.MAVLink_mission_ack_message(255, 190, dialect.MAV_MISSION_UNSUPPORTED))
    link.receive(0.2)
    with pytest.raises(RunError, match=r"robot_0: refuses .* item 2, command 16 \(unsupported\)"):
        upload.advance(0.2)


def test_a_silent_autopilot_ends_the_upload(ends):
    link, _ = ends
    upload = MissionUpload(link, ITEMS)
    upload.advance(0.0)
    assert not upload.advance(19.0)
    with pytest.raises(RunError, match="requests no mission item for 20 s"):
        upload.advance(21.0)


def test_completed_items_are_kept_with_their_times(ends):
    link, far = ends
    for number, time_s in ((1, 3.0), (2, 4.5)):
        far.say(dialect.MAVLink_mission_item_reached_message(number))
        link.receive(time_s)
    assert link.reached == [(1, 3.0), (2, 4.5)]
