"""Files of timed keys: read, refused with the line's number, written and read again."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.teleop import script
from angler_mjx.teleop.script import KeyScript, TimedKey


@pytest.fixture
def file(tmp_path):
    return tmp_path / "keys.txt"


def read(file, text):
    file.write_text(text)
    return script.load_keys(file)


def test_a_line_is_a_time_and_a_key(file):
    timed = read(
        file, "# a comment\n\n2.0 i\n2.5 <tab>   # the other robot\n3 <space>\n4 <Ctrl-C>\n"
    )
    assert timed == [
        TimedKey(2.0, "i"),
        TimedKey(2.5, "\t"),
        TimedKey(3.0, " "),
        TimedKey(4.0, "\x03"),
    ]


def test_a_held_key_repeats_among_the_others(file):
    timed = read(file, "1-1.3 i\n1.15 q\n")
    assert [one.key for one in timed] == ["i", "i", "q", "i", "i"]
    assert [one.time_s for one in timed] == pytest.approx([1.0, 1.1, 1.15, 1.2, 1.3])


FAULTS = {
    "no key": ("2.0", "give a time in seconds and a key"),
    "two keys": ("2.0 i k", "give a time in seconds and a key"),
    "no time": ("soon i", "'soon' is not a time"),
    "negative": ("-1 i", "-1 is not a time from 0 s on"),
    "not a number": ("nan i", "nan is not a time from 0 s on"),
    "unknown name": ("2.0 <tabulator>", "'<tabulator>' is not a key"),
    "backwards": ("1.0 i", "comes before the line above it (2 s)"),
    "held for no time": ("3-3 i", "held until 3 s"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_malformed_line_is_named_by_its_number(file, fault):
    line, reason = FAULTS[fault]
    with pytest.raises(ConfigError) as caught:
        read(file, f"# first\n2.0 i\n{line}\n5.0 k\n")
    message = str(caught.value)
    assert str(file) in message
    assert "1 fault\n" in message
    assert f"line 3: '{line}': " in message
    assert reason in message


def test_all_faults_come_in_one_message(file):
    with pytest.raises(ConfigError, match="2 faults") as caught:
        read(file, "x i\n1 i\n2 <y>\n")
    assert "line 1" in str(caught.value)
    assert "line 3" in str(caught.value)


def test_a_file_of_something_else_fills_no_screen(file):
    with pytest.raises(ConfigError, match="40 faults") as caught:
        read(file, "key = 1\n" * 40)
    assert str(caught.value).count("\n") == script.MAX_FAULTS + 1
    assert str(caught.value).endswith("and 30 more")


def test_keys_that_are_too_many_are_not_made_first(file):
    """A day's worth of keys on each of 2,000 lines would be 1.7e9 of them, some 100 GB."""
    with pytest.raises(ConfigError, match="1999 faults") as caught:
        read(file, "0-86400 i\n" * 2000)
    assert "line 2: '0-86400 i': more than 1,000,000 keys up to here" in str(caught.value)


def test_files_without_keys_are_refused(file, tmp_path):
    with pytest.raises(ConfigError, match="holds no key"):
        read(file, "# nothing\n")
    with pytest.raises(ConfigError, match="cannot be read"):
        script.load_keys(tmp_path / "absent.txt")


def test_keys_come_once_when_their_time_has_come():
    keys = KeyScript([TimedKey(0.1, "i"), TimedKey(0.15, "k"), TimedKey(0.3, "Q")])
    # 0.15 s as a sum of periods of 0.05 s is 0.15000000000000002 s.
    times = [0.0, 0.05, 0.1, 0.05 + 0.05 + 0.05, 0.2, 0.25]
    assert [keys.read(time) for time in times] == [[], [], ["i"], ["k"], [], []]
    assert not keys.finished
    assert keys.read(1.0) == ["Q"]
    assert keys.finished


def test_what_is_saved_is_read_again(file):
    times = [0.1, 0.1 + 0.2, 7.0, 1234.55]
    timed = [TimedKey(time, key) for time, key in zip(times, ["i", "\t", "<", "\x03"], strict=True)]
    script.save_keys(file, timed)
    assert script.load_keys(file) == timed
