"""Cases of the simulator's fuzz: a scenario, what drives its robots, and the worlds to look at.

A case is a folder that can be run again: ``scenario.toml`` and, where a robot carries ballast, its
vehicle file beside it. What a scenario has no key for stands in the file's first line, a comment.
"""

import dataclasses
import json
import random
import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.stages import CONTROLLERS
from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.scenario import Scenario, load_scenario

DRIVERS = (
    ("signals", "cascade"),
    ("paths", "cascade"),
    ("paths", "pid"),
    ("signals", "pid"),
    ("paths", "los"),
    ("paths", "tracking"),
    ("signals", "cascade"),
    ("paths", "computed_torque"),
    ("paths", "ismc"),
    ("paths", "aitsm"),
    ("paths", "ardusub"),
)
"""In turn: random signals of thrusters, or a controller on planned paths. That of arms is the
cascade of the rigid vehicles here."""
assert {name for _, name in DRIVERS} == set(CONTROLLERS) - {"arm"}

CURRENTS = ("uniform", "gauss_markov", "vortices", "depth_profile", "tide")

PLACES = ("deep", "surface", "corner", "floor", "rock")
"""In turn."""

SCALED = re.compile(r"^(mass_kg|volume_m3|inertia_kgm2) = (.*)$", re.MULTILINE)
NUMBER = re.compile(r"\d+\.?\d*(?:e-?\d+)?")


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scenario as tables, with what it has no key for."""

    scenario: dict[str, Any]
    signals: bool = False
    """Whether `signals.Signals` drives the robots instead of their paths."""
    vehicles: dict[str, str] = field(default_factory=dict)
    """Text of the vehicle files beside the scenario, by name."""
    world: int | None = None
    """The world that fails; all if None."""
    referee: int = 0
    """Worlds that are recorded and given to the referee."""

    def write(self, folder: Path, why: str = "") -> Path:
        """Put it into a folder; returns the scenario file."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in self.vehicles.items():
            (folder / name).write_text(text, encoding="utf-8")
        about = {"signals": self.signals, "world": self.world, "referee": self.referee}
        path = folder / "scenario.toml"
        lines = [f"# fuzz: {json.dumps(about)}", *(f"# {line}" for line in why.splitlines())]
        lines.append(f"# python -m tests.fuzz.simulator --case {path}")
        path.write_text("\n".join([*lines, "", toml(self.scenario)]), encoding="utf-8")
        return path

    def load(self, folder: Path, **changed: Any) -> Scenario:
        """Checked, with what it needs on the disk in ``folder``."""
        return load_scenario(self.write(folder), **changed)

    def but(self, **changed: Any) -> "Case":
        """The same with other top-level keys of the scenario."""
        return dataclasses.replace(self, scenario=_drawable({**self.scenario, **changed}))


def read(path: Path) -> Case:
    """Read a case that `Case.write` wrote.

    Raises:
        ConfigError: the file's first line is not that of a case.
    """
    text = path.read_text(encoding="utf-8")
    head, _, rest = text.partition("\n")
    if not head.startswith("# fuzz: "):
        raise ConfigError(f"--case {path}: is no case: its first line does not begin with # fuzz:")
    about = json.loads(head.removeprefix("# fuzz: "))
    scenario = tomllib.loads(rest)
    names = {entry["vehicle"] for entry in scenario["fleet"]}
    beside = {name: path.parent / name for name in names if name.endswith(".toml")}
    vehicles = {name: place.read_text(encoding="utf-8") for name, place in beside.items()}
    return Case(scenario=scenario, vehicles=vehicles, **about)


def draw(seed: int, number: int, *, worlds: int, horizon_s: float = 60.0) -> Case:
    """The case of that number; drivers and places come in turn, the rest is drawn."""
    rng = random.Random(f"{seed}/simulator/{number}")
    driver, controller = DRIVERS[number % len(DRIVERS)]
    place = PLACES[number % len(PLACES)]
    fleet, vehicles = _fleet(rng, rock=place == "rock")
    robots = sum(entry["count"] for entry in fleet)
    physics = rng.choice([0.01, 0.01, 0.01, 0.005, 0.02])
    # Signals often change with every step of the physics; controllers have their usual periods.
    often = [0.01, 0.02, 0.05] if driver == "signals" else [0.02, 0.05, 0.1]
    control = rng.choice([one for one in often if round(one / physics, 6) % 1 == 0])
    scenario = {
        "name": f"fuzz-{seed}-{number}",
        "description": f"{place}, {driver} {controller}",
        "worlds": worlds,
        "seed": rng.randrange(2**31),
        "time": {
            "horizon_s": horizon_s,
            "physics_dt_s": physics,
            "control_dt_s": control,
            "record_hz": 1.0 / control,
        },
        "water": {"density_kgpm3": rng.choice([1000.0, round(rng.uniform(900, 1100), 1)])},
        "world": _world(rng, place, robots),
        "controller": {"name": controller},
        "fleet": fleet,
    }
    if rng.random() < 0.4:
        scenario["randomise"] = _randomise(rng, scenario)
    return Case(scenario=scenario, signals=driver == "signals", vehicles=vehicles)


def _drawable(scenario: dict[str, Any]) -> dict[str, Any]:
    """A scenario without ranges of what is not in it any more."""
    gone = set()
    if not scenario["world"].get("currents"):
        gone.add("current")
    if all(entry.get("estimate", "truth") == "truth" for entry in scenario["fleet"]):
        gone.add("sensor_noise")
    if not gone & scenario.get("randomise", {}).keys():
        return scenario
    kept = {key: x for key, x in scenario["randomise"].items() if key not in gone}
    return {**scenario, "randomise": kept}


def _randomise(rng: random.Random, scenario: dict[str, Any]) -> dict[str, Any]:
    """Ranges that leave every vehicle afloat."""
    spans = {"damping": (0.5, 2.0), "added_mass": (0.5, 2.0)}
    if not any(entry["vehicle"].endswith(".toml") for entry in scenario["fleet"]):
        # Not those with ballast: some just hold their depth.
        spans |= {
            "mass": (0.95, 1.05),
            "buoyancy": (0.97, 1.03),
            "thrust": (0.7, 1.1),
            "battery_v": (12.0, 18.0),
        }
    if scenario["world"].get("currents"):
        spans["current"] = (0.0, 2.0)
    if any(entry.get("estimate", "truth") != "truth" for entry in scenario["fleet"]):
        spans["sensor_noise"] = (0.0, 3.0)
    found: dict[str, Any] = {
        name: sorted(round(rng.uniform(low, high), 2) for _ in range(2))
        for name, (low, high) in spans.items()
        if rng.random() < 0.5
    }
    if rng.random() < 0.3:
        found |= {"fault_probability": 0.2, "fault_health": [0.0, 0.5]}
    return {"variants": rng.choice([1, 3]), "visible": rng.random() < 0.5, **found}


def _fleet(rng: random.Random, *, rock: bool) -> tuple[list[dict[str, Any]], dict[str, str]]:
    entries, vehicles, rotor = [], {}, rng.choice(["first_order", "first_order", "third_order"])
    # Both engines fly a case, and one flies no arms.
    rigid = [name for name in library.list_rovs() if not library.load_vehicle(name).links]
    for i in range(rng.choice([1, 1, 2, 2, 3])):
        name = rng.choice(rigid)
        config = library.load_vehicle(name)
        sets = list(config.published_sets)
        entry: dict[str, Any] = {
            "vehicle": name,
            "count": rng.choice([1, 1, 2]),
            "battery_v": round(rng.uniform(10, 20), 2),
            "cruise_speed_mps": round(rng.uniform(0.1, 3.0), 2),
            "rotor_response": rotor,
            "parameter_mix": dict.fromkeys(rng.sample(sets, rng.randint(1, len(sets))), 1.0),
        }
        if rng.random() < 0.4:
            entry["vehicle"] = f"ballast-{i}.toml"
            vehicles[entry["vehicle"]] = ballast(
                rng, library.locate_vehicle(name).read_text(encoding="utf-8")
            )
        if rng.random() < 0.4:
            layout = [thruster.name for thruster in config.thrusters.layout]
            faulty = rng.sample(layout, rng.randint(1, 3))
            entry["thruster_health"] = {one: rng.choice([0.0, 0.3, 0.7]) for one in faulty}
            entry["fault_visible"] = rng.random() < 0.5
        estimate = rng.choice(["truth", "truth", "noisy", "ekf"])
        if estimate != "truth":
            entry["estimate"] = estimate
        entries.append(entry)
    return entries, vehicles


def ballast(rng: random.Random, text: str) -> str:
    """A vehicle file with other masses, inertias and volumes: up to half heavy or half light."""
    share = {
        "mass_kg": rng.uniform(0.7, 1.5),
        "volume_m3": rng.uniform(0.7, 1.5),
        "inertia_kgm2": rng.uniform(0.3, 3.0),
    }

    def scaled(found: re.Match[str]) -> str:
        by = share[found[1]]
        return f"{found[1]} = " + NUMBER.sub(lambda one: repr(float(one[0]) * by), found[2])

    changed = SCALED.sub(scaled, text)
    assert changed != text
    return changed


def _world(rng: random.Random, place: str, robots: int) -> dict[str, Any]:
    world: dict[str, Any] = {"preset": "open", "currents": _currents(rng)}
    if place == "rock":
        world["preset"] = rng.choice(["reef", "sparse", "dense", "corridor"])
        world["placement"] = rng.choice(["cross", "random"])
        world["depth_m"] = rng.choice([0.0, 2.0])
        world["obstacles"] = {"dynamic": {"count": rng.choice([0, 6, 12])}}
        return world
    # Water that a robot drifts in for a minute at 3 m/s, and does not reach the end.
    world.update(shape=[8, 8, 2], cell_m=50.0, depth_m=0.0, placement="given", clearance_m=0.0)
    middle, step = {
        "deep": ((0.0, 0.0, -50.0), (3.0, 0.0, 0.0)),
        "surface": ((0.0, 0.0, -0.6), (3.0, 0.0, 0.1)),
        "floor": ((0.0, 0.0, -99.0), (3.0, 0.0, 0.0)),
        "corner": (rng.choice([(-199.0, -199.0, -1.0), (-199.0, 199.0, -99.0)]), (2.0, 0.0, 0.0)),
    }[place]
    world["start_m"] = [
        [m + i * s for m, s in zip(middle, step, strict=True)] for i in range(robots)
    ]
    away = [rng.uniform(5, 60) for _ in range(robots)]
    depth = [-1.0 if place == "surface" else rng.uniform(-97, -2) for _ in range(robots)]
    world["goal_m"] = [
        [start[0] + x, start[1] + (-x if start[1] > 0 else x), z]
        for start, x, z in zip(world["start_m"], away, depth, strict=True)
    ]
    return world


def _currents(rng: random.Random) -> list[dict[str, Any]]:
    """None to three, of which each may have 3 m/s."""
    kinds = rng.sample(CURRENTS, rng.choice([0, 1, 1, 2, 3]))
    found: list[dict[str, Any]] = []
    for kind in kinds:
        speed = round(rng.uniform(0.3, 3.0), 2)
        if kind == "uniform":
            way = [rng.gauss(0, 1) for _ in range(3)]
            size = sum(x * x for x in way) ** 0.5
            found.append({"type": kind, "velocity_mps": [x / size * speed for x in way]})
        elif kind == "gauss_markov":
            memory, knot = rng.choice([(60.0, 5.0), (5.0, 1.0), (1.0, 0.5)])
            found.append(
                {"type": kind, "max_speed_mps": speed, "time_constant_s": memory, "knot_dt_s": knot}
            )
        elif kind == "depth_profile":
            knots = sorted(rng.sample(range(101), rng.choice([2, 3, 5])))
            found.append(
                {
                    "type": kind,
                    "depth_m": [float(one) for one in knots],
                    "speed_mps": [0.1, speed],
                    "turn_deg": rng.choice([0.0, 90.0, 180.0]),
                }
            )
        elif kind == "tide":
            found.append(
                {
                    "type": kind,
                    "constituents": [
                        {
                            "name": name,
                            "major_mps": round(0.5 * speed, 2),
                            "minor_mps": round(rng.uniform(-0.5, 0.5) * speed, 2),
                            "inclination_deg": round(rng.uniform(0, 180), 1),
                            "phase_deg": round(rng.uniform(0, 360), 1),
                        }
                        for name in rng.sample(["M2", "S2", "K1", "M8"], rng.choice([1, 2]))
                    ],
                }
            )
        else:
            # Many narrow ones: seen from above the region is 400 m wide.
            found.append(
                {
                    "type": kind,
                    "count": rng.choice([3, 100]),
                    "peak_speed_mps": [0.1, speed],
                    "core_radius_m": [1.0, rng.choice([1.5, 10.0, 60.0])],
                }
            )
    return found


def simpler(case: Case) -> list[Case]:
    """Cases with one thing less, those that leave out most first."""
    scenario, found = case.scenario, []
    fleet, world = scenario["fleet"], scenario["world"]

    def with_fleet(entries: list[dict[str, Any]]) -> Case:
        count = sum(entry["count"] for entry in entries)
        given = {key: world[key][:count] for key in ("start_m", "goal_m") if key in world}
        names = {entry["vehicle"] for entry in entries}
        kept = {name: text for name, text in case.vehicles.items() if name in names}
        fewer = case.but(fleet=entries, world={**world, **given})
        return dataclasses.replace(fewer, vehicles=kept)

    if len(fleet) > 1:
        found += [with_fleet([entry]) for entry in fleet]
    found += [
        with_fleet([*fleet[:i], {**entry, "count": 1}, *fleet[i + 1 :]])
        for i, entry in enumerate(fleet)
        if entry["count"] > 1
    ]
    currents = world.get("currents", [])
    if currents:
        found.append(case.but(world={**world, "currents": []}))
    if len(currents) > 1:
        found += [case.but(world={**world, "currents": [one]}) for one in currents]
    if "obstacles" in world:
        found.append(case.but(world={k: v for k, v in world.items() if k != "obstacles"}))
    time = scenario["time"]
    found += [
        case.but(time={**time, "horizon_s": shorter})
        for shorter in (2.0, 10.0, 30.0)
        if shorter < time["horizon_s"]
    ]
    # Rotors of a fleet are alike.
    plain = [{k: v for k, v in entry.items() if k != "rotor_response"} for entry in fleet]
    found += [with_fleet(plain)] if plain != fleet else []
    for i, entry in enumerate(fleet):
        for key in ("thruster_health", "estimate", "parameter_mix"):
            if key in entry:
                dropped = (key, "fault_visible") if key == "thruster_health" else (key,)
                less = {k: v for k, v in entry.items() if k not in dropped}
                found.append(with_fleet([*fleet[:i], less, *fleet[i + 1 :]]))
    if scenario.get("randomise"):
        found.append(case.but(randomise={}))
    if scenario["controller"]["name"] != "cascade":
        found.append(case.but(controller={"name": "cascade"}))
    return found


def toml(table: dict[str, Any]) -> str:
    """The text of a file: tables as inline tables but for those at the top and their lists."""
    plain = [f"{key} = {_value(x)}" for key, x in table.items() if not _is_table(x)]
    parts = ["\n".join(plain)]
    for key, x in table.items():
        if _is_table(x):
            head = f"[[{key}]]" if isinstance(x, list) else f"[{key}]"
            for one in x if isinstance(x, list) else [x]:
                parts.append("\n".join([head, *(f"{k} = {_value(v)}" for k, v in one.items())]))
    return "\n\n".join(parts) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value)
