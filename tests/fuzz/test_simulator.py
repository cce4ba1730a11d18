"""A small campaign with each engine in every run of the tests; `make fuzz-sim` flies thousands.

And what the campaign's own judges must see: energy from nowhere, robots that jump, NaN.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.vehicles.rotor import RotorFilter
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome, Tally

from . import agreement, cases, flying, simulator
from .cases import Case
from .energy import Books, Rotors
from .flying import Fault, Flight
from .signals import HABITS, Signals

SMALL = Case(
    scenario={
        "name": "small",
        "description": "two Heavies at random signals, at the surface and in a strong current",
        "worlds": 6,
        "seed": 3,
        "time": {"horizon_s": 4.0, "physics_dt_s": 0.01, "control_dt_s": 0.01, "record_hz": 100.0},
        "world": {
            "preset": "open",
            "shape": [4, 4, 2],
            "cell_m": 50.0,
            "depth_m": 0.0,
            "placement": "given",
            "start_m": [[0.0, 0.0, -0.3], [4.0, 0.0, -20.0]],
            "goal_m": [[20.0, 20.0, -30.0], [-20.0, 20.0, -30.0]],
            "currents": [
                {
                    "type": "gauss_markov",
                    "max_speed_mps": 2.0,
                    "time_constant_s": 2.0,
                    "knot_dt_s": 1.0,
                },
                {"type": "vortices", "count": 50, "peak_speed_mps": [0.5, 1.5]},
            ],
        },
        "fleet": [{"vehicle": "bluerov2_heavy", "count": 2, "parameter_set": "wu2018"}],
    },
    signals=True,
)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Worlds, flights by both engines, all samples of the first, and the bounds."""
    place, flights, samples = tmp_path_factory.mktemp("case"), [], []
    mjx, fused = (
        Simulator(SMALL.load(place, engine=engine), policy=Signals())
        for engine in simulator.ENGINES
    )
    worlds = mjx.worlds()
    flights = [
        flying.fly(mjx, worlds, 0, samples.append),
        flying.fly(fused, fused.adopt(worlds), 0),
    ]
    return mjx.add_parameters(worlds), flights, samples, simulator.bounds(mjx, worlds)


@pytest.mark.nightly(by="the judges' own tests below")
def test_nothing_is_wrong_with_either_engine(flown):
    _, flights, _, bounds = flown
    for flight in flights:
        assert [fault.line() for fault in flight.faults] == []
        assert flight.fastest_radps > 2.0
    faults, _ = agreement.compare(*flights, bounds)
    assert [fault.line() for fault in faults] == []


def balance(worlds, samples, **changed):
    vehicle = replace(worlds.control.vehicle, **changed.pop("vehicle", {}))
    known = {"current": worlds.environment.current, "density": 1000.0, "gravity": 9.81, "dt": 0.01}
    books = Books(vehicle=vehicle, **{**known, **changed})
    step = 0
    for sample in samples:
        for i in range(sample.p.shape[1]):
            flies = np.isin(sample.outcome[:, i], flying.FLYING)
            at = (sample.p, sample.q, sample.nu, sample.pwm_us)
            books.add(*(np.asarray(x[:, i]) for x in at), flies, 0.01 * step)
            step += 1
    return books


@pytest.mark.nightly(by="physics/test_energy.py")
def test_energy_is_what_thrusters_and_water_gave(flown):
    worlds, _, samples, _ = flown
    books = balance(worlds, samples)
    assert books.worst.max() < 0.7
    assert books.turned_over.min() > 1.0
    assert np.median(books.turned_over) > 50.0


@pytest.mark.nightly(by="physics/test_energy.py")
@pytest.mark.parametrize(
    ("name", "factor"),
    [("D_q", 1.3), ("M_A", 1.5), ("thrust_n", 1.15), ("volume_m3", 1.05), ("mass_kg", 1.05)],
)
def test_energy_of_another_vehicle_does_not_balance(flown, name, factor):
    worlds, _, samples, _ = flown
    other = {name: factor * getattr(worlds.control.vehicle, name)}
    assert balance(worlds, samples, vehicle=other).worst.max() > 1.0


@pytest.mark.nightly(by="physics/test_energy.py")
def test_energy_of_still_water_does_not_balance(flown):
    worlds, _, samples, _ = flown
    assert balance(worlds, samples, current=()).worst.max() > 1.0


def test_rotors_of_third_order_settle_and_have_the_mean_of_their_thrust():
    class Vehicle:
        rotor = RotorFilter(numerator=(0.0, 6136.0, 108700.0), denominator=(89.0, 9258.0, 108700.0))

    coarse, fine = Rotors(Vehicle, 0.05), Rotors(Vehicle, 0.0005)
    asked = np.full((1, 1, 1), 10.0)
    _, after, mean = coarse.advance(asked)
    track = [fine.advance(asked) for _ in range(100)]
    np.testing.assert_allclose(after, track[-1][1], rtol=1e-9)
    np.testing.assert_allclose(mean, np.mean([part[2] for part in track], axis=0), rtol=1e-9)
    for _ in range(20):
        _, after, _ = coarse.advance(asked)
    np.testing.assert_allclose(after, 10.0, rtol=1e-6)


def test_signals_have_all_habits_and_stay_in_range():
    habit = jnp.arange(HABITS)
    drawn = Signals()._drawn(habit, jax.random.key(0), (HABITS, 8))
    assert np.all((drawn >= 1100) & (drawn <= 1900))
    assert set(np.unique(drawn[1])) == {1100.0, 1900.0}
    assert np.all(np.abs(np.asarray(drawn[5]) - 1500) <= 40)


# --- what is no number


def arrays(**changed):
    shape = (2, 3, 1)
    sound = {
        "p": np.zeros((*shape, 3)),
        "q": np.tile([1.0, 0.0, 0.0, 0.0], (*shape, 1)),
        "nu": np.zeros((*shape, 6)),
        "pwm_us": np.full((*shape, 6), 1500.0),
        "outcome": np.zeros(shape, int),
    }
    for name, (place, value) in changed.items():
        sound[name][place] = value
    return sound


DIVERGED = ((1, slice(2, None), 0), int(Outcome.DIVERGED))


@pytest.mark.parametrize(
    ("changed", "worlds"),
    [
        ({}, []),
        ({"nu": ((1, 2, 0, 3), np.nan)}, [1]),
        ({"nu": ((1, 2, 0, 3), np.inf), "outcome": DIVERGED}, [1]),
        ({"pwm_us": ((1, 2, 0, 3), np.nan)}, [1]),
        ({"pwm_us": ((1, 2, 0, 3), np.nan), "outcome": DIVERGED}, []),
        ({"pwm_us": ((0, 1, 0, 0), 1901.0)}, [0]),
        ({"q": ((0, 1, 0, 0), 0.9)}, [0]),
    ],
)
def test_what_is_no_number_is_seen(changed, worlds):
    found = flying.numbers(arrays(**changed), 0, 0, 0.01)
    assert [fault.world for fault in found] == worlds


# --- engines


def flight(x, outcome, end_s, least=1.0):
    """One robot along x [S] m, at 20 Hz."""
    steps = len(x)
    p = np.zeros((1, steps, 1, 3), np.float32)
    p[0, :, 0, 0] = x
    one = {name: np.zeros((1, 1)) for name in Tally.__dataclass_fields__}
    one |= {"outcome": np.array([[outcome]]), "end_time_s": np.array([[end_s]])}
    one |= {"min_clearance_m": np.array([[least]]), "min_separation_m": np.array([[np.inf]])}
    return Flight(first=7, tally=Tally(**one), p=p, time_s=0.05 * np.arange(steps))


BOUNDS = agreement.Bounds(
    goal_m=np.array([[[9.0, 0.0, 0.0]]]),
    low_m=np.full(3, -10.0),
    high_m=np.full(3, 10.0),
    goal_tolerance_m=0.3,
)
WAY = np.linspace(0, 6, 200)
HIT, RUNNING = Outcome.COLLISION_STATIC, Outcome.RUNNING


@pytest.mark.parametrize(
    ("other", "faults", "excused"),
    [
        (flight(WAY, HIT, 8.0), 0, 0),
        (flight(WAY + 1e-5, HIT, 8.05, least=-1e-3), 0, 1),
        (flight(WAY, RUNNING, 0.0, least=1e-3), 0, 1),
        (flight(WAY, RUNNING, 0.0, least=0.3), 1, 0),
        (flight(WAY, Outcome.REACHED, 8.0), 1, 0),
        # Apart by a centimetre at once, after 2 s.
        (flight(WAY + 0.01 * (WAY > 1.2), HIT, 8.0), 1, 0),
        # Apart from the beginning, as by another force.
        (flight(WAY * 1.01, HIT, 8.0), 1, 0),
        # Parted by a motion that takes errors times eight in every second: anything may follow.
        (flight(WAY + 1e-6 * 8 ** np.arange(0, 10, 0.05)[:200], RUNNING, 0.0), 0, 1),
    ],
)
def test_engines_may_part_by_rounding_alone(other, faults, excused):
    found = agreement.compare(flight(WAY, HIT, 8.0, least=-1e-3), other, BOUNDS)
    assert [len(part) for part in found] == [faults, excused], found


# --- cases


@pytest.mark.parametrize("number", range(0, 55, 5))
def test_drawn_cases_are_scenarios_and_come_back_from_their_files(number, tmp_path):
    case = cases.draw(1, number, worlds=8)
    assert case == cases.draw(1, number, worlds=8) != cases.draw(2, number, worlds=8)
    scenario = case.load(tmp_path)
    assert scenario.time.steps_per_sample == 1
    path = case.write(tmp_path, "why\nit fails")
    assert cases.read(path) == case
    assert load_scenario(path) == scenario
    assert all(one.load(tmp_path / "simpler") for one in cases.simpler(case))


def test_campaigns_meet_every_driver_at_every_place():
    met = {cases.draw(0, number, worlds=1).scenario["description"] for number in range(55)}
    wanted = {
        f"{place}, {driver} {controller}"
        for place in cases.PLACES
        for driver, controller in cases.DRIVERS
    }
    assert met == wanted


def test_a_failing_case_is_made_simple_and_fails_from_its_file(tmp_path, monkeypatch):
    """With an examiner that finds fault where there are vortices and a vehicle with ballast."""

    def examine(case, engines, *, tile=8):
        scenario = case.scenario
        bad = bool(case.vehicles) and any(
            one["type"] == "vortices" for one in scenario["world"]["currents"]
        )
        fault = Fault(kind="energy", world=5, robot=0, said="from nowhere")
        return simulator.Found(faults=[fault] if bad else [])

    monkeypatch.setattr(simulator, "examine", examine)
    numbers = (n for n in range(55) if examine(cases.draw(0, n, worlds=8), ()).faults)
    case = next(
        one
        for one in (cases.draw(0, n, worlds=8) for n in numbers)
        if len(one.scenario["fleet"]) > 1 and len(one.scenario["world"]["currents"]) > 1
    )
    kept, faults = simulator.shrink(
        case, examine(case, ()).faults[0], simulator.ENGINES, tile=8, tries=60
    )
    scenario = kept.scenario
    assert (kept.world, scenario["worlds"], scenario["tile"]) == (5, 6, 1)
    assert [one["type"] for one in scenario["world"]["currents"]] == ["vortices"]
    assert len(scenario["fleet"]) == len(kept.vehicles) == 1
    assert scenario["time"]["horizon_s"] == 2.0
    read = cases.read(kept.write(tmp_path, faults[0].line()))
    assert examine(read, ()).faults
    assert not any(examine(one, ()).faults for one in cases.simpler(read))
