"""Endpoints a user names: strings, sorting by system number, streams, what is not heard."""

import os
import pty
import socket
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import ConfigError
from angler_sitl.wire.endpoint import Endpoint, parse_endpoint
from angler_sitl.wire.link import MavlinkLink

LOOPBACK = "127.0.0.1"


def codec(sysid, component=1):
    return dialect.MAVLink(None, srcSystem=sysid, srcComponent=component)


def beat(sysid, component=1, mode=4):
    return dialect.MAVLink_heartbeat_message(12, 3, 128, mode, 4, 3).pack(codec(sysid, component))


def udp():
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.bind((LOOPBACK, 0))
    bound.settimeout(2.0)
    return bound


@pytest.fixture
def port():
    with udp() as probe:
        return probe.getsockname()[1]


@pytest.fixture
def listening(port):
    endpoint = Endpoint(parse_endpoint(f"udp:{LOOPBACK}:{port}"))
    yield endpoint
    endpoint.close()


def drain(channel, limit_s=2.0):
    """Packets that arrive until there are none for a moment."""
    packets, end = [], time.monotonic() + limit_s
    while time.monotonic() < end:
        try:
            packets.append(channel.recvfrom(65536)[0])
        except BlockingIOError:
            if packets:
                return packets
            time.sleep(0.01)
    return packets


@pytest.mark.parametrize(
    ("text", "kind", "host", "number"),
    [
        ("udp:127.0.0.1:14550", "udpin", "127.0.0.1", 14550),
        ("udpin:0.0.0.0:14551", "udpin", "0.0.0.0", 14551),
        ("udpout:192.168.2.2:14550", "udpout", "192.168.2.2", 14550),
        ("tcp:localhost:5760", "tcp", "localhost", 5760),
        ("/dev/ttyACM0", "serial", "/dev/ttyACM0", 115200),
        ("/dev/ttyUSB0,57600", "serial", "/dev/ttyUSB0", 57600),
    ],
)
def test_connection_strings_are_those_of_mavproxy(text, kind, host, number):
    address = parse_endpoint(text)
    assert (address.kind, address.host, address.port) == (kind, host, number)


@pytest.mark.parametrize(
    "text",
    ["", "127.0.0.1:14550", "udp:14550", "udp:host:", "udp:host:0", "udp:host:65536", "tcp::5760",
     "http://host:80", "/dev/", "/dev/ttyUSB0,fast", "udp:host:14550x", "udp:host:١٤"],
)  # fmt: skip
def test_another_string_is_refused_with_an_example(text):
    with pytest.raises(ConfigError, match=r"--endpoint .*udp:127\.0\.0\.1:14550"):
        parse_endpoint(text)


def test_packets_are_sorted_by_system_number(listening, port):
    channels = {sysid: listening.open_channel(sysid) for sysid in (1, 2)}
    with udp() as first, udp() as second:
        first.sendto(beat(1), (LOOPBACK, port))
        second.sendto(beat(2, mode=16) + beat(3), (LOOPBACK, port))
        packets = {sysid: drain(channel) for sysid, channel in channels.items()}
    assert packets == {1: [beat(1)], 2: [beat(2, mode=16)]}
    assert listening.heard == {1: 1, 2: 1, 3: 1}
    assert listening.counts == {"foreign": 1}


def test_answers_go_to_the_vehicle_that_is_meant(listening, port):
    links = [
        MavlinkLink(listening.open_channel(sysid), name=f"robot_{sysid}", sysid=sysid)
        for sysid in (1, 2)
    ]
    with udp() as first, udp() as second:
        first.sendto(beat(1), (LOOPBACK, port))
        second.sendto(beat(2), (LOOPBACK, port))
        time.sleep(0.05)
        for link in links:
            link.receive(0.0)
        links[1].command(dialect.MAV_CMD_DO_SET_MODE, 1, 4)
        (command,) = codec(9).parse_buffer(second.recv(65536))
        assert (command.target_system, command.command) == (2, dialect.MAV_CMD_DO_SET_MODE)
        first.setblocking(False)
        with pytest.raises(BlockingIOError):
            first.recv(65536)


def test_a_second_sender_of_the_same_number_is_counted_and_ignored(listening, port):
    channel = listening.open_channel(1)
    with udp() as vehicle, udp() as other:
        vehicle.sendto(beat(1, mode=4), (LOOPBACK, port))
        assert drain(channel) == [beat(1, mode=4)]
        other.sendto(beat(1, mode=19), (LOOPBACK, port))
        vehicle.sendto(beat(1, mode=16), (LOOPBACK, port))
        assert drain(channel) == [beat(1, mode=16)]
    assert listening.counts["moved"] == 1


def test_rubbish_is_counted_and_spoils_nothing(listening, port):
    channel = listening.open_channel(1)
    broken = bytearray(beat(1))
    broken[-1] ^= 0xFF  # its checksum
    with udp() as vehicle, udp() as other:
        other.sendto(b"\xfd\xff rubbish" * 20, (LOOPBACK, port))
        vehicle.sendto(bytes(broken), (LOOPBACK, port))
        vehicle.sendto(beat(1), (LOOPBACK, port))
        assert drain(channel) == [beat(1)]
    assert listening.counts["bad"] >= 1


def test_a_flood_of_sources_is_not_kept(listening, port):
    listening.open_channel(1)
    sockets = [udp() for _ in range(70)]
    for sender in sockets:
        sender.sendto(beat(1), (LOOPBACK, port))
    time.sleep(0.1)
    listening.poll()
    for sender in sockets:
        sender.close()
    assert listening.counts["moved"] == 69
    assert listening.heard[1] == 64


def test_udpout_greets_so_that_the_vehicle_answers(port):
    with udp() as vehicle:
        host, number = vehicle.getsockname()
        endpoint = Endpoint(parse_endpoint(f"udpout:{host}:{number}"))
        endpoint.greet()
        data, source = vehicle.recvfrom(65536)
        (greeting,) = codec(1).parse_buffer(data)
        assert (greeting.get_srcSystem(), greeting.type) == (255, dialect.MAV_TYPE_GCS)
        channel = endpoint.open_channel(1)
        vehicle.sendto(beat(1), source)
        assert drain(channel) == [beat(1)]
        endpoint.close()


def test_tcp_is_one_stream_and_its_end_is_named():
    with socket.create_server((LOOPBACK, 0)) as server:
        endpoint = Endpoint(parse_endpoint(f"tcp:{LOOPBACK}:{server.getsockname()[1]}"))
        vehicle, _ = server.accept()
        channel, stream = endpoint.open_channel(1), beat(1) + beat(1, mode=16)
        vehicle.sendall(stream[:15])  # in the middle of the first packet
        time.sleep(0.05)
        endpoint.poll()
        assert not channel.packets
        vehicle.sendall(stream[15:])
        assert drain(channel) == [beat(1), beat(1, mode=16)]
        vehicle.close()
        time.sleep(0.05)
        endpoint.poll()
        assert "closed" in endpoint.fault
        endpoint.write(b"nobody", (LOOPBACK, 1))  # is lost, as on every other transport
        endpoint.close()


def test_a_serial_line_is_raw():
    ours, theirs = pty.openpty()
    endpoint = Endpoint(parse_endpoint(f"{os.ttyname(theirs)},57600"))
    channel = endpoint.open_channel(1)
    packet = beat(1, mode=13)  # 13 and 10 are what a terminal would change
    os.write(ours, packet)
    assert drain(channel) == [packet]
    channel.sendto(b"\r\n\x03\x04 raw", (os.ttyname(theirs), 57600))
    assert os.read(ours, 100) == b"\r\n\x03\x04 raw"
    endpoint.close()
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("/dev/no_such_line", "No such file"),
        ("/dev/null", "no serial line"),
        (f"tcp:{LOOPBACK}:1", "refused"),
    ],
)
def test_what_cannot_be_opened_is_one_message(text, reason):
    with pytest.raises(ConfigError, match=f"--endpoint {text}: .*{reason}"):
        Endpoint(parse_endpoint(text))


def test_an_odd_baud_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="12345 baud"):
        Endpoint(parse_endpoint("/dev/null,12345"))


def test_a_port_in_use_is_one_message(port):
    first = Endpoint(parse_endpoint(f"udp:{LOOPBACK}:{port}"))
    with pytest.raises(ConfigError, match="in use"):
        Endpoint(parse_endpoint(f"udp:{LOOPBACK}:{port}"))
    first.close()
