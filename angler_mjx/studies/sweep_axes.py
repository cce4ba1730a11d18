"""What a sweep varies: keys of a scenario and their values, as a command line gives them.

``KEY=VALUE,VALUE,...``. A key is dotted, with entries of lists by their index from 0, or * for all
of them. A value is written as in a scenario file (TOML): numbers, true, false, "text", [lists],
{tables}; text without blanks, brackets or quotes needs no quotes. Commas within brackets or quotes
belong to the value.
"""

import re
import tomllib
from collections.abc import Iterable, Iterator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.studies.grid import SettingAxis

RESERVED_KEYS = {
    "worlds": "give --worlds: the cells of a sweep have the same worlds",
    "seed": "give --seed: the cells of a sweep have the same worlds",
    "name": "cells are named by their settings",
    "description": "it changes nothing that is flown",
    "schema_version": "it is that of the file",
}
"""Keys that no sweep varies, and what to do instead."""

_KEY = re.compile(r"[A-Za-z0-9_-]+(\.([A-Za-z0-9_-]+|\*))*")
_WORD = re.compile(r"[^\s\"'\[\]{}=,]+")
_CLOSED_BY = {"[": "]", "{": "}"}


def parse_axes(texts: Iterable[str]) -> tuple[SettingAxis, ...]:
    """Axes of a sweep.

    Args:
        texts: each KEY=VALUE,VALUE,...

    Raises:
        ConfigError: with a line for each that is none.
    """
    setting_axes, faults = [], []
    for text in texts:
        try:
            setting_axes.append(parse_axis(text))
        except ConfigError as error:
            faults.append(str(error))
    keys = [setting_axis.key for setting_axis in setting_axes]
    faults += [
        f"--set {key}: is there twice; give all its values in one, as in {key}=A,B"
        for key in dict.fromkeys(keys)
        if keys.count(key) > 1
    ]
    inside = [(a, b) for a in dict.fromkeys(keys) for b in keys if b.startswith(f"{a}.")]
    faults += [f"--set {b}: lies within {a}, which is set too; give one of them" for a, b in inside]
    if faults:
        raise ConfigError("\n".join(faults))
    if not setting_axes:
        raise ConfigError("--set: nothing is varied; give KEY=VALUE,VALUE,... once or more")
    return tuple(setting_axes)


def parse_axis(text: str) -> SettingAxis:
    """One axis from its text.

    Raises:
        ConfigError: it is none.
    """
    key, equals, rest = text.partition("=")
    key = key.strip()
    if not equals or not _KEY.fullmatch(key):
        raise ConfigError(
            f"--set {format_value(text)}: give KEY=VALUE,VALUE,... with a dotted key, such as "
            "fleet.0.count=1,2,4"
        )
    if key in RESERVED_KEYS:
        raise ConfigError(f"--set {key}: {RESERVED_KEYS[key]}")
    names = tuple(part.strip() for part in _split_values(rest, text))
    values = tuple(_parse_value(key, name) for name in names)
    for i, name in enumerate(names):
        if values[i] in values[:i] and type(values[i]) in map(type, values[:i]):
            raise ConfigError(f"--set {key}={name}: is there twice; give each value once")
    return SettingAxis(key=key, values=values, names=names)


def _split_values(rest: str, text: str) -> Iterator[str]:
    """Texts between the commas that stand in no bracket and no quotes."""
    open_, quote, begin = [], "", 0
    for i, char in enumerate(rest):
        if quote:
            quote = "" if char == quote and rest[i - 1] != "\\" else quote
        elif char in "\"'":
            quote = char
        elif char in _CLOSED_BY:
            open_.append(_CLOSED_BY[char])
        elif char in _CLOSED_BY.values():
            if not open_ or open_.pop() != char:
                raise ConfigError(
                    f"--set {format_value(text)}: {char!r} closes nothing; balance brackets"
                )
        elif char == "," and not open_:
            yield rest[begin:i]
            begin = i + 1
    if open_ or quote:
        missing = quote or open_[-1]
        raise ConfigError(f"--set {format_value(text)}: {missing!r} is missing at the end; add it")
    yield rest[begin:]


def _parse_value(key: str, name: str) -> object:
    """A value from its text."""
    if not name:
        raise ConfigError(f"--set {key}: a value is missing; write one before and after each comma")
    try:
        table = tomllib.loads(f"value = {name}")
    except ValueError as error:
        if _WORD.fullmatch(name):
            return name
        raise ConfigError(
            f"--set {key}: {format_value(name)} is no value; write it as in a scenario file: "
            '1.5, "text", [1, 2], { a = 1 }'
        ) from error
    value: object = table["value"]
    return value
