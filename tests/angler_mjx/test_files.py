"""What no file may do to its reader, and how the message of a fault looks."""

from typing import Annotated

import pytest
from pydantic import Field

from angler_mjx.errors import (
    MAX_VALUE_CHARACTERS,
    ConfigError,
    escape_control_characters,
    format_bytes,
    format_value,
)
from angler_mjx.files import FileModel, parse_json, parse_model, read_json, read_text, read_toml


class Inner(FileModel):
    share: float = 0.5


class Model(FileModel):
    count: int = 1
    speed_mps: float = 1.0
    on: bool = False
    word: str = ""
    place: tuple[float, float] = (0.0, 0.0)
    inner: tuple[Inner, ...] = ()


def told(data):
    with pytest.raises(ConfigError) as caught:
        parse_model(Model, data, source="a.toml")
    return str(caught.value)


def test_integers_do_for_floats_and_lists_for_tuples():
    made = parse_model(Model, {"speed_mps": 2, "place": [1, 2.5]}, source="a.toml")
    assert (made.speed_mps, made.place) == (2.0, (1.0, 2.5))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("count", True), ("count", "4"), ("count", 4.0), ("speed_mps", "12"), ("speed_mps", False),
        ("on", 1), ("on", "true"), ("word", 3), ("place", "12"), ("place", [1.0, True]),
        ("count", 2**63), ("speed_mps", 10**400), ("speed_mps", float("nan")), ("word", "\ud800"),
    ],
)  # fmt: skip
def test_a_wrong_type_is_one_fault_that_names_the_key(key, value):
    message = told({key: value})
    assert message.startswith("a.toml: 1 fault\n  " + key)


def test_values_are_cut_and_control_characters_escaped():
    message = told({"word": 1, "count": "x" * 5000, "\x1b[2J": 1})
    assert len(message) < 600
    assert "3 faults" in message
    assert all(char.isprintable() or char == "\n" for char in message)
    assert r"\x1b[2J" in message


def test_tables_within_tables_without_end_are_refused():
    deep = {"a": 1}
    for _ in range(500):
        deep = {"a": deep}
    assert "unknown key" in told(deep)
    lists = [1.0]
    for _ in range(500):
        lists = [lists]
    assert told({"place": lists}).count("\n") == 2  # two numbers are wanted, one list is there


def test_a_tuple_is_not_called_short_for_its_members_faults():
    class Outer(FileModel):
        inner: Annotated[tuple[Inner, ...], Field(min_length=1)]

    for held, count in (([{"share": "a"}], 1), ([], 1), ([{"share": "a"}, {"x": 1}], 2)):
        with pytest.raises(ConfigError) as caught:
            parse_model(Outer, {"inner": held}, source="a.toml")
        assert str(caught.value).count("\n") == count


NOT_TOML = {
    "digits": "a = " + "9" * 5000,
    "lists": "a = " + "[" * 5000,
    "tables": "a = " + "{a=" * 5000,
    "dotted": ".".join("a" * 5000) + " = 1",
    "quoted": ".".join(['"a"'] * 5000) + " = 1",
    "zeros": "\x00",
}


@pytest.mark.parametrize("kind", NOT_TOML)
def test_toml_that_would_break_its_reader_is_refused(kind, tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(NOT_TOML[kind])
    with pytest.raises(ConfigError, match=r"a\.toml: (not valid TOML|a key has 64)"):
        read_toml(path)


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 100_000, "9" * 5000, '{"a":1,"a":2}'],
    ids=["lists", "objects", "digits", "twice"],
)
def test_json_that_would_break_its_reader_is_refused(text):
    with pytest.raises(ConfigError, match="a file: "):
        parse_json(text, "a file")


def test_large_endless_missing_and_named_oddly(tmp_path):
    with pytest.raises(ConfigError, match="more than"):
        read_text((tmp_path / "/dev/zero"), 1000)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_json(tmp_path / "none.json")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(tmp_path / "a\0b.toml")
    with pytest.raises(ConfigError) as caught:
        read_toml(tmp_path / "a\x1b[31m\nb.toml")
    assert r"a\x1b[31m\nb.toml: cannot be read" in str(caught.value)


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path):
    # As Windows' Notepad writes files: its mark would be part of the first name.
    for name, text in (("a.toml", "count = 3\n"), ("a.json", '{"count": 3}'), ("a.txt", "count 3")):
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert read_toml(tmp_path / "a.toml") == read_json(tmp_path / "a.json") == {"count": 3}
    assert read_text(tmp_path / "a.txt", 100).split() == ["count", "3"]


def test_a_file_of_another_kind_is_not_told_fault_by_fault():
    message = told({f"key_{i}": 1 for i in range(30)})
    assert message.count("\n") == 21
    assert message.endswith("and 10 more")
    assert "another kind of file" in told({f"key_{i}": 1 for i in range(2000)})


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (10**5000, "(an integer of 16610 bits)"),
        ([1, [2, [3, [4]]]], "[1, [2, [3, [...]]]]"),
        ({"a": (1, 2)}, "{'a': [1, 2]}"),
        ("\x07", r"'\x07'"),
    ],
    ids=["integer", "lists", "table", "bell"],
)
def test_how_values_are_shown(value, text):
    assert format_value(value) == text


def test_a_size_is_never_nought_point_nought_gigabytes():
    said = [format_bytes(n) for n in (0, 999, 1000, 1_843_200, 3.46e9, 1.2e12)]
    assert said == ["0 bytes", "999 bytes", "1 kB", "1.84 MB", "3.46 GB", "1.2e+03 GB"]


def test_no_value_is_shown_in_full_length():
    for value in ("x" * 10**6, list(range(10**6)), {"k" * 10**6: 1}, [["y" * 100] * 100] * 100):
        assert len(format_value(value)) == MAX_VALUE_CHARACTERS


def test_escapes_keep_what_prints():
    assert escape_control_characters("Ångström 12 °C\n") == "Ångström 12 °C\n"
    assert escape_control_characters("a\r\x9b\u202e") == r"a\r\x9b\u202e"
    assert str(ConfigError("a\tb")) == r"a\tb"
    assert len(str(ConfigError("a " + "b" * 10**6))) < 100
