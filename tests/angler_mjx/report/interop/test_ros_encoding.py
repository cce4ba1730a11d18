"""Bytes and hashes of ROS types against libraries of others: mcap-ros2-support and rosbags."""

import random
import re
import timeit

import pytest
from mcap_ros2._dynamic import serialize_dynamic
from rosbags.typesys import Stores, get_typestore

from angler_mjx.report.interop.ros_definitions import message_definition
from angler_mjx.report.interop.ros_encoding import find_decoder, find_encoder
from angler_mjx.report.interop.ros_types import ALL_FIELDS, SERVICES, dds_name, full_name, type_hash

JAZZY = get_typestore(Stores.ROS2_JAZZY)
PLAIN = [name for name in ALL_FIELDS if "_" not in name.partition("/")[2]]
RANGES = {"u": (0, 255), "i": (-100, 100), "c": (0, 100), "b": (0, 1)}


def sample(name, source, empty=0.2):
    """A message with random values; some fields are left out."""
    message = {}
    for line in ALL_FIELDS[name].splitlines():
        if "=" in line or source.random() < empty:
            continue
        kind, field = line.split()[:2]
        base, bracket, length = kind.rstrip("]").partition("[")
        count = int(length) if length else source.randrange(4)
        values = [value(base, source, empty) for _ in range(count)]
        message[field] = values if bracket else value(base, source, empty)
    return message


def value(base, source, empty):
    if "/" in base:
        return sample(base, source, empty)
    if base == "string":
        return "ä" * source.randrange(6) + "x"
    if base.startswith("float"):
        return source.choice([0.5, -3.25, 1e6])
    return source.randint(*RANGES[base[0]])


@pytest.mark.parametrize("name", PLAIN)
def test_bytes_are_those_of_the_library(name):
    full = name.replace("/", "/msg/")
    expected = serialize_dynamic(full, message_definition(name, ALL_FIELDS))[full]
    source = random.Random(name)
    # The library takes a missing field `values` for the method of a dict.
    empty = 0.0 if name.startswith("diagnostic_msgs/") else 0.2
    messages = [{}] * bool(empty) + [sample(name, source, empty) for _ in range(30)]
    for message in messages:
        assert find_encoder(name)(message) == bytes(expected(message))


@pytest.mark.parametrize("name", ALL_FIELDS)
def test_what_is_written_is_read(name):
    source = random.Random(name)
    for _ in range(10):
        message = sample(name, source, empty=0.0)
        read = find_decoder(name)(find_encoder(name)(message))
        for field, expected in message.items():
            found = getattr(read, field)
            if isinstance(expected, str):
                assert found == expected
            elif not isinstance(expected, dict | list):
                assert float(found) == float(expected)


@pytest.mark.parametrize("name", [name for name in ALL_FIELDS if full_name(name) in JAZZY.types])
def test_hashes_are_those_of_rosbags(name):
    if name == "service_msgs/ServiceEventInfo":
        pytest.skip("rosbags takes a char of its for another type than ROS does")
    assert type_hash(name) == JAZZY.hash_rihs01(full_name(name))


OFFICIAL = {
    "std_srvs/Trigger": ("eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
    "std_srvs/SetBool": ("abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"),
    "rcl_interfaces/SetParameters": (
        "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0"
    ),
    "action_msgs/CancelGoal": ("573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"),
    "control_msgs/FollowJointTrajectory_SendGoal": (
        "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
    ),
    "control_msgs/FollowJointTrajectory_GetResult": (
        "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"
    ),
    "control_msgs/FollowJointTrajectory_FeedbackMessage": (
        "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"
    ),
}


def test_hashes_of_services_are_those_of_the_generator_of_ros():
    """Of ROS 2 Kilted's rosidl_generator_type_description 4.9.5."""
    for name, digest in OFFICIAL.items():
        assert type_hash(name) == f"RIHS01_{digest}"


def test_names_have_their_kind():
    assert dds_name("nav_msgs/Odometry") == "nav_msgs::msg::dds_::Odometry_"
    assert dds_name("std_srvs/Trigger") == "std_srvs::srv::dds_::Trigger_"
    send = dds_name("control_msgs/FollowJointTrajectory_SendGoal")
    assert send == "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_"
    for name in SERVICES:
        assert re.fullmatch(r"\w+/(srv|action)/\w+", full_name(f"{name}_Request"))


def test_it_is_faster_than_the_library():
    """Its speed is why it is there."""
    name, full = "nav_msgs/Odometry", "nav_msgs/msg/Odometry"
    message = sample(name, random.Random(0), empty=0.0)
    slow = serialize_dynamic(full, message_definition(name))[full]
    fast = find_encoder(name)
    times = [min(timeit.repeat(lambda f=f: f(message), number=200, repeat=5)) for f in (fast, slow)]
    assert times[0] < 0.6 * times[1]
