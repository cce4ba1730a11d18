"""`angler bench`: how fast this machine is, as a table and as JSON lines."""

from pathlib import Path

from angler_mjx.cli.device import Device, choose


def bench(
    scenario: str = "reef_fleet",
    worlds: int = 256,
    repeats: int = 10,
    device: Device | None = None,
    out: Path = Path("benchmarks/results.jsonl"),
) -> None:
    """Measure how fast worlds are drawn, planned and simulated on this machine.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file.
        worlds: Worlds in one device call.
        repeats: Timed calls; median, least and greatest are given.
        device: Where to compute; JAX's choice if left out.
        out: File to which one JSON line a row is appended.
    """
    choose(device)
    from rich.console import Console
    from rich.table import Table

    from angler_mjx.benchmark import speed
    from angler_mjx.runs.scenario import load_scenario

    loaded = load_scenario(scenario)
    rows = speed.measure(loaded, worlds=worlds, repeats=repeats)
    speed.record(rows, out)
    table = Table("workload", "worlds x robots", "median (spread)", "compile")
    for row in rows:
        table.add_row(
            row.workload,
            f"{row.worlds} x {row.robots}",
            f"{row.median:.2e} {row.unit} ({(row.high - row.low) / row.median:.0%})",
            f"{row.compile_s:.1f} s",
        )
    console = Console()
    console.print(table)
    for row in rows:
        console.print(f"{row.workload}: timed is {row.inside}", highlight=False)
    print(out)
