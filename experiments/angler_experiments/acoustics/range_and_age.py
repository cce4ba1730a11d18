"""Range of packets of a small modem, and age of a team's information on itself.

    python -m angler_experiments.acoustics.range_and_age --out docs/images

Ranges are the equations of `docs/reference/acoustics.md` alone. Ages are those of robots at rest in
a cube of 24 m that hear each other perfectly but for collisions, simulated by the channel of a
rollout; in turn they are compared with the closed form, and `--smoke` fails if they differ.
"""

import csv
from functools import partial
from pathlib import Path
from typing import TypedDict

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from angler_mjx.files import JsonTable
from angler_mjx.report.plotting import style
from angler_mjx.world.acoustics import channel
from angler_mjx.world.acoustics.access import Tdma
from angler_mjx.world.acoustics.channel import Channel, ChannelInput, ModemState
from angler_mjx.world.acoustics.config import AcousticsConfig
from angler_mjx.world.rock.grid import Grid

SIZE_M = (24.0, 24.0, 24.0)
DT_S = 0.05
TEAMS = (2, 4, 8, 16, 32)
NOISY_DB = 90.0
"""Density of a receiver's own noise, dB re 1 uPa^2/Hz: 50 dB above the sea's."""
LINKS: dict[str, JsonTable] = {
    "BPSK, no fading": {"fading": "none"},
    "FSK, no fading": {"modulation": "fsk", "fading": "none"},
    "BPSK, Rayleigh": {},
    "FSK, Rayleigh": {"modulation": "fsk"},
    "BPSK, Rayleigh, noisy receiver": {"self_noise_db": NOISY_DB},
}
ACCESS = {"tdma": "in turn (TDMA)", "slotted_aloha": "slotted ALOHA", "aloha": "ALOHA"}
TOLERANCE = 0.02
"""Relative tolerance of mean ages in turn, against the closed form; the start times of packets
shift them."""


def compute_successes(range_m: np.ndarray) -> dict[str, np.ndarray]:
    """Return the probability of receiving a packet of 128 bits, [n] of ranges [n], by link."""
    success_by_link = {}
    for name, settings in LINKS.items():
        link = AcousticsConfig.model_validate({"model": "budget", **settings}).link()
        success_by_link[name] = np.asarray(link.success(range_m, 0.0))
    return success_by_link


def build_channel(access: str, robots: int) -> Channel:
    """Build a channel in which only collisions lose packets, at the load of maximum throughput.

    Args:
        access: medium access.
        robots: number of robots of the channel.
    """
    settings = {"model": "range", "range_m": 100.0, "rock": "lets_pass", "access": access}
    base_config = AcousticsConfig.model_validate(settings)
    packet_s = base_config.bits / base_config.bit_rate_bps
    slot_s = 0.25  # a packet and its travel time, in control steps
    each_s = slot_s if access == "slotted_aloha" else 2.0 * packet_s
    loaded_config = base_config.model_copy(update={"interval_s": max(robots * each_s, 0.6)})
    channel_model = loaded_config.channel(robots, SIZE_M, DT_S, 1e6)
    if channel_model is None:
        raise RuntimeError("a channel of some range is none")
    return channel_model


class AgeRow(TypedDict):
    """Mean age of information in teams of one size."""

    access: str
    robots: int
    age_s: float


type Carry = tuple[ModemState, jax.Array]
"""States of the channels [world], and sums of the ages [world]."""


def mean_age_s(acoustic_channel: Channel, robots: int, seconds: float, worlds: int) -> float:
    """Return the mean age [s] of a robot's information on another, after a fifth of the time."""
    steps = round(seconds / DT_S)
    position_m = jax.random.uniform(jax.random.key(0), (worlds, robots, 3)) * jnp.array(SIZE_M)
    empty_grid = Grid(
        occupied=jnp.zeros((1, 1, 1), bool), origin_m=jnp.zeros(3), cell_m=jnp.ones(())
    )
    other = ~jnp.eye(robots, dtype=bool)

    def advance(
        number: jax.Array, key: jax.Array, p_m: jax.Array, memory: ModemState
    ) -> tuple[ModemState, jax.Array]:
        t = number * DT_S
        packet = channel.Packet(p_m=p_m, v_mps=jnp.zeros_like(p_m), time_s=jnp.full(robots, t))
        inputs = ChannelInput(
            key=jax.random.fold_in(key, number),
            number=number,
            p_m=p_m,
            grid=empty_grid,
            make_packet=lambda: packet,
        )
        memory, _ = channel.step(acoustic_channel, memory, inputs)
        age = jnp.sum(jnp.where(other, t - memory.heard.time_s, 0.0)) / jnp.sum(other)
        return memory, age

    def run(keys: jax.Array) -> jax.Array:
        def step(carry: Carry, number: jax.Array) -> tuple[Carry, None]:
            memory, total = carry
            memory, age = jax.vmap(partial(advance, number))(keys, position_m, memory)
            return (memory, total + jnp.where(number >= steps // 5, age, 0.0)), None

        begin_state = jax.vmap(partial(channel.begin_channel, acoustic_channel))(position_m)
        (_, total), _ = jax.lax.scan(step, (begin_state, jnp.zeros(worlds)), jnp.arange(steps))
        return jnp.mean(total) / (steps - steps // 5)

    return float(jax.jit(run)(jax.random.split(jax.random.key(1), worlds)))


def expected_age_s(acoustic_channel: Channel, robots: int) -> float:
    """Return mean age in closed form: received a slot after its start, and a frame until the next.

    A packet of 0.2 s and up to 28 ms of travel time is received after 0.25 s, in steps of 0.05 s.
    """
    if not isinstance(acoustic_channel.access, Tdma):
        raise ValueError("robots do not take turns")
    slot_s = acoustic_channel.access.slot * DT_S
    return slot_s + 0.5 * (robots * slot_s - DT_S)


def plot_figure(out: Path, rows: list[AgeRow]) -> None:
    """Plot both charts, side by side."""
    range_m = np.geomspace(10.0, 30_000.0, 300)
    with style.figure_style():
        chart = style.new_figure(9.0, 3.6)
        left, right = chart.subplots(1, 2)
        for i, (name, success) in enumerate(compute_successes(range_m).items()):
            left.semilogx(range_m, success, color=style.robot_color(i), label=name)
        left.set(xlabel="range, m", ylabel="packets of 128 bits understood", ylim=(-0.02, 1.02))
        left.legend(fontsize=7, ncol=2, loc="lower left", bbox_to_anchor=(0.0, 1.01))
        for i, (access, text) in enumerate(ACCESS.items()):
            access_rows = [row for row in rows if row["access"] == access]
            right.loglog(
                [row["robots"] for row in access_rows],
                [row["age_s"] for row in access_rows],
                "o-",
                color=style.robot_color(i),
                label=text,
            )
        right.set(xlabel="robots", ylabel="mean age of what is known, s", xticks=TEAMS)
        right.set_xticklabels([str(team) for team in TEAMS])
        right.minorticks_off()
        right.legend(fontsize=7)
        style.save_figure(chart, out / "acoustics.png", palette=64)


def main(out: Path = Path("docs/images"), seconds: float = 400.0, smoke: bool = False) -> None:
    """Plot the figure and write its numbers beside it.

    Args:
        out: Folder of the figure.
        seconds: Simulated time for each age.
        smoke: Two small teams and a minute, to see that it works.
    """
    teams, seconds = (TEAMS[:2], 60.0) if smoke else (TEAMS, seconds)
    rows: list[AgeRow] = []
    for access in ACCESS:
        for robots in teams:
            acoustic_channel = build_channel(access, robots)
            worlds = max(2, 64 // robots)
            age = mean_age_s(acoustic_channel, robots, seconds, worlds)
            rows.append({"access": access, "robots": robots, "age_s": round(age, 4)})
            print(rows[-1])
            if access == "tdma":
                expected = expected_age_s(acoustic_channel, robots)
                if abs(age / expected - 1.0) > TOLERANCE:
                    raise SystemExit(f"{robots} robots in turn: {age:.3f} s, not {expected:.3f} s")
    out.mkdir(parents=True, exist_ok=True)
    with (out / "acoustics.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, ("access", "robots", "age_s"), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    if not smoke:
        plot_figure(out, rows)


if __name__ == "__main__":
    tyro.cli(main)
