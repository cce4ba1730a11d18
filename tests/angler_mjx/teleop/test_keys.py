"""The bindings against the documentation of teleop_twist_keyboard, typed from its README."""

import itertools

from angler_mjx.teleop import keys
from angler_mjx.teleop.keys import ACTIONS, FACTORS, HELP, MOVES, Direction, KeyAction
from angler_mjx.teleop.status import WIDTH

# "Moving around: u i o / j k l / m , ." and, with shift held, "U I O / J K L / M < >": the row says
# forward, stay or backward; the column says left, neither or right. Left is a turn to port without
# shift and a sideways move to port with it. Backward to the left turns the other way, so that the
# stern goes where the key points: that program publishes m as (-1, 0, 0, -1).
PLAIN = ("uio", "jkl", "m,.")
SHIFTED = ("UIO", "JKL", "M<>")
ROWS, COLUMNS = (1, 0, -1), (1, 0, -1)


def test_moves_are_those_of_the_documentation():
    wanted = {"t": Direction(0, 0, 1, 0), "b": Direction(0, 0, -1, 0)}
    for (i, surge), (j, left) in itertools.product(enumerate(ROWS), enumerate(COLUMNS)):
        turn = -left if surge < 0 else left
        wanted[PLAIN[i][j]] = Direction(surge, 0, 0, turn)
        wanted[SHIFTED[i][j]] = Direction(surge, left, 0, 0)
    assert wanted == MOVES


def test_speeds_are_those_of_the_documentation():
    # "q/z : increase/decrease max speeds by 10%, w/x : only linear, e/c : only angular".
    assert FACTORS == {
        "q": (1.1, 1.1), "z": (0.9, 0.9), "w": (1.1, 1.0),
        "x": (0.9, 1.0), "e": (1.0, 1.1), "c": (1.0, 0.9),
    }  # fmt: skip


def test_our_own_keys_take_none_of_theirs():
    assert not set(ACTIONS) & {*MOVES, *FACTORS}
    assert set(ACTIONS.values()) == set(KeyAction)


def test_help_shows_every_key_and_fits_the_screen():
    shown = " ".join(HELP)
    written = {"\t": "tab", "\x03": "Ctrl-C"}
    for key in {*MOVES, *FACTORS, *ACTIONS}:
        assert f" {written.get(key, key)}" in shown
    assert max(map(len, HELP)) <= WIDTH


def test_a_key_that_a_file_cannot_hold_is_written_as_another_that_stops():
    assert keys.format_key("\t") == "<tab>"
    assert keys.format_key("i") == "i"
    for odd in ("#", "\x7f", "\n", " "):
        assert odd not in {**MOVES, **FACTORS, **ACTIONS}
        assert keys.format_key(odd) == "<space>"
