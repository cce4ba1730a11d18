"""Inputs that are wrong: random bytes, and valid files with something done to them.

Everything comes from a `random.Random`, so that a seed and a number name an input for good.
"""

import copy
import json
import re
import tomllib

NASTY = (
    "99999999999999999999", "-9223372036854775809", "9" * 400, "9" * 5000, "1e308", "-1e308",
    "1e-320", "1e999", "nan", "inf", "-inf", "0", "-0.0", "0x" + "f" * 400, "true", "false",
    '""', '"4"', '"' + "x" * 5000 + '"', '"\\u001b[2J"', '"\\u0000"', '"../../etc/passwd"',
    '"/dev/zero.toml"', '"\\ud800"', "[]", "{}", "[[]]", "[" * 50 + "]" * 50, "[" * 3000,
    '{"a":' * 3000, "null", "1979-05-27T07:32:00Z", "1_000", "[nan, 1, 2]", "'", '"', "1.5", "2",
    "1000000", "1e9", "0.001", "-1", "[1, 2, 3]", '["a"]',
)  # fmt: skip
_VALUE = re.compile(
    r"(?<=[=:,\[{\s])(?:-?\d[\d.eE+_-]*|true|false|\"[^\"\n]*\"|'[^'\n]*')(?=[\s,\]}]|$)", re.M
)
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_BYTES = (b"\x00", b"\xff", b"\x1b", b"\n", b'"', b"[", b"{", b"=", b".", b"-", b"\xf0\x9f\x92\xa9")


def wrong(rng, valid, others, end=""):
    """One input: a valid one with a few changes, or bytes from nowhere."""
    kind = rng.random()
    if kind > 0.5 and end in (".json", ".jsonl"):
        return odd(rng, valid, others, json.loads, json.dumps)
    if kind > 0.5 and end == ".toml":
        return odd(rng, valid, others, tomllib.loads, toml_dumps)
    if kind < 0.08:
        return rng.randbytes(int(rng.expovariate(1 / 200)))
    data = valid
    for _ in range(1 + int(rng.expovariate(0.8))):
        text = rng.random() < 0.75
        data = _text(rng, data, others) if text else _raw(rng, data, others)
    return data[: 1 << 20]


def _text(rng, data, others):
    text = data.decode("utf-8", "surrogateescape")
    what = rng.randrange(8)
    if what <= 3 and (found := list(_VALUE.finditer(text))):
        at = rng.choice(found)
        text = text[: at.start()] + rng.choice(NASTY) + text[at.end() :]
    elif what == 4 and (found := list(_WORD.finditer(text))):
        at, by = rng.choice(found), rng.choice(found)
        text = text[: at.start()] + by[0] + text[at.end() :]
    elif what == 5 and (found := list(_WORD.finditer(text))):
        at = rng.choice(found)
        longer = rng.choice(["x" * 3000, ".".join("a" * rng.randrange(2, 300)), at[0].upper()])
        text = text[: at.start()] + longer + text[at.end() :]
    else:
        text = "".join(_lines(rng, text.splitlines(keepends=True), others))
    return text.encode("utf-8", "surrogateescape")


def _lines(rng, lines, others):
    if not lines:
        return ["x"]
    first = rng.randrange(len(lines))
    last = min(len(lines), first + rng.randrange(1, 6))
    taken = lines[first:last]
    match rng.randrange(5):
        case 0:
            return lines[:first] + lines[last:]
        case 1:
            return lines[:last] + taken * rng.choice([1, 2, 300]) + lines[last:]
        case 2:
            at = rng.randrange(len(lines) + 1)
            return lines[:at] + taken + lines[at:]
        case 3:
            other = rng.choice(others).decode("utf-8", "replace").splitlines(keepends=True) or ["x"]
            return [*lines[:first], rng.choice(other), *lines[first:]]
        case _:
            return [*lines[:first], f"{rng.choice(NASTY)} = {rng.choice(NASTY)}\n", *lines[first:]]


def _raw(rng, data, others):
    at = rng.randrange(len(data) + 1)
    match rng.randrange(6):
        case 0:
            return data[:at] + rng.choice(_BYTES) * rng.choice([1, 1, 1, 2000]) + data[at:]
        case 1:
            return data[:at]
        case 2:
            return data[:at] + rng.randbytes(rng.randrange(1, 9)) + data[at + rng.randrange(9) :]
        case 3 if data:
            at = rng.randrange(len(data))
            return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        case 4:
            other = rng.choice(others)
            cut = rng.randrange(len(other) + 1)
            return data[:at] + other[cut : cut + rng.randrange(1, 200)] + data[at:]
        case _:
            return data[:at] + data[: rng.randrange(len(data) + 1)] + data[at:]


ODD = (
    10**19, -(2**63) - 1, 10**400, 2**63 - 1, 2**31, 1e308, -1e308, 1e-320, 5e-324, 0, -1, 1, 2,
    0.5, -0.0, float("nan"), float("inf"), True, False, "", "4", "x" * 3000, "\x1b[2J",
    "../../x.toml", "/dev/null.toml", [], {}, [[]], [True], ["a"], [1, 2, 3], [0.0] * 6,
    [[0.0] * 6] * 6,
    [[1e9, 2e9, 3e9]] * 3, {"type": "box"}, {"type": "circle"}, {"": 0}, 1e9, 1e-9, 1000, 128, 1e5,
)  # fmt: skip


def odd(rng, data, others, loads, dumps):
    """A valid table with a few of its values, keys or parts changed, written as its language."""
    try:
        table = loads(data.decode("utf-8"))
        other = loads(rng.choice(others).decode("utf-8"))
    except ValueError:
        return data
    for _ in range(1 + int(rng.expovariate(0.7))):
        places, elsewhere = list(_places(table)), list(_places(other))
        if not places:
            break
        holder, key = rng.choice(places)
        match rng.randrange(8):
            case 0 if isinstance(holder, dict):
                del holder[key]
            case 1 if isinstance(holder, list):
                holder.extend(copy.deepcopy(holder[key]) for _ in range(rng.choice([1, 3, 50])))
            case 2 if elsewhere:
                there, name = rng.choice(elsewhere)
                holder[key] = copy.deepcopy(there[name])
            case 3 if elsewhere and isinstance(holder, dict):
                there, name = rng.choice(elsewhere)
                holder[str(name)] = copy.deepcopy(there[name])
            case 4 if isinstance(holder[key], int | float) and abs(holder[key]) < 1e200:
                holder[key] *= rng.choice([-1, 0, 1e-6, 0.1, 3, 10, 1e3, 1000, 1e6, 1e12])
            case _:
                holder[key] = copy.deepcopy(rng.choice(ODD))
    return dumps(table).encode("utf-8", "backslashreplace")


def _places(value):
    entries = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in entries:
        yield value, key
        if isinstance(inner, dict | list):
            yield from _places(inner)


def toml_dumps(table):
    """A table as TOML, everything below its first level inline."""
    return "".join(f"{json.dumps(str(key))} = {_inline(value)}\n" for key, value in table.items())


def _inline(value):
    match value:
        case bool():
            return str(value).lower()
        case dict():
            return (
                f"{{{', '.join(f'{json.dumps(str(k))} = {_inline(v)}' for k, v in value.items())}}}"
            )
        case list():
            return f"[{', '.join(map(_inline, value))}]"
        case str():
            return json.dumps(value)
        case int() | float():
            return str(value)
    return json.dumps(str(value))
