"""Messages as bytes of CDR and back: the only encoder, of bags and of live topics."""

import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic

from angler_mjx.report.interop.ros_definitions import message_definition
from angler_mjx.report.interop.ros_types import ALL_FIELDS


def _join_words(name: str) -> str:
    """Return the name of a part of a service or action as that of a message, as in ``A_Request``.

    The library takes names of messages alone, which have no underscores.
    """
    package, _, short = name.partition("/")
    return f"{package}/{short.replace('_', '')}"


_FIELDS = {
    _join_words(name): re.sub(r"\w+/\w+", lambda match: _join_words(match[0]), text)
    for name, text in ALL_FIELDS.items()
}
"""Fields by names without underscores."""

type Encoder = Callable[[Mapping[str, object]], bytes]
type Decoder = Callable[[bytes], Any]


@cache
def find_encoder(name: str) -> Encoder:
    """Return the encoder of a message; missing fields are 0 or empty.

    Args:
        name: package/Name, one of `ros_types.ALL_FIELDS`.
    """
    joined = _join_words(name)
    full = joined.replace("/", "/msg/")
    encode: Encoder = serialize_dynamic(full, message_definition(joined, _FIELDS))[full]
    return encode


@cache
def find_decoder(name: str) -> Decoder:
    """Return the decoder of a message into an object with its fields as attributes.

    It raises an exception of any type for bytes that are not such a message.

    Args:
        name: package/Name, one of `ros_types.ALL_FIELDS`.
    """
    joined = _join_words(name)
    full = joined.replace("/", "/msg/")
    decode: Decoder = generate_dynamic(full, message_definition(joined, _FIELDS))[full]
    return decode
