"""Messages as bytes of CDR and back: the only encoder, of bags and of live topics."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic

from angler_mjx.report.interop.ros_definitions import message_definition
from angler_mjx.report.interop.ros_types import ALL_FIELDS

type Encoder = Callable[[Mapping[str, object]], bytes]
type Decoder = Callable[[bytes], Any]


@cache
def find_encoder(name: str) -> Encoder:
    """Return the encoder of a message; missing fields are 0 or empty.

    Args:
        name: package/Name, one of `ros_types.ALL_FIELDS`.
    """
    full = name.replace("/", "/msg/")
    encode: Encoder = serialize_dynamic(full, message_definition(name, ALL_FIELDS))[full]
    return encode


@cache
def find_decoder(name: str) -> Decoder:
    """Return the decoder of a message into an object with its fields as attributes.

    It raises an exception of any type for bytes that are not such a message.

    Args:
        name: package/Name, one of `ros_types.ALL_FIELDS`.
    """
    full = name.replace("/", "/msg/")
    decode: Decoder = generate_dynamic(full, message_definition(name, ALL_FIELDS))[full]
    return decode
