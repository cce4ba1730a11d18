"""Results of a benchmark that never was: plausible, repeatable, with every kind of row."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from angler_mjx.runs.storage.episode_columns import EPISODE_SCHEMA

PRESETS = {"open": 0.0, "sparse": 0.02, "reef": 0.06, "dense": 0.12}
NAMES = (
    "grid", "RRTConnect", "RRT", "RRTstar", "InformedRRTstar", "SORRTstar", "BITstar",
    "AORRTC", "PRM", "PRMstar", "FMT", "BFMT", "KPIECE1", "LBKPIECE1",
)  # fmt: skip
ENDS = ("collision_static", "collision_dynamic", "collision_robot", "timeout")

TEXT, INT, FLOAT, BOOL = pa.string(), pa.int64(), pa.float64(), pa.bool_()
SCHEMA = pa.schema(
    [("run", INT)]
    + [(n, TEXT) for n in ("planner", "planner_name", "scene", "preset")]
    + [("robots", pa.int32()), ("knows_obstacles", TEXT), ("knows_current", TEXT)]
    + [("problem_seed", INT), ("world", INT), ("plan_status", TEXT), ("plan_reason", TEXT)]
    + [(n, FLOAT) for n in ("planning_s", "warm_up_s", "first_s", "best_s")]
    + [("planned", BOOL), ("robots_planned", pa.int32())]
    + [(n, FLOAT) for n in ("plan_length_m", "plan_makespan_s", "plan_flowtime_s", "plan_turn_rad")]
    + [("flown", BOOL), ("robots_reached", pa.int32()), ("reached", BOOL), ("success", BOOL)]
    + [(n, FLOAT) for n in ("makespan_s", "flowtime_s", "late_s", "path_length_m", "energy_j")]
    + [(n, FLOAT) for n in ("min_clearance_m", "min_separation_m")]
    + [("failure", TEXT)]
    + [(n, FLOAT) for n in ("failure_time_s", "failure_x_m", "failure_y_m", "failure_z_m")]
    + [("failure_robot", pa.int32()), ("failure_pair", TEXT)]
    + [(n, FLOAT) for n in ("density", "path_ratio", "free_lines", "straight_m")]
)


def write(
    folder, *, planners=NAMES, presets=("open", "reef", "dense"), teams=(1, 2, 4, 8, 16),
    worlds=20, flown=True, examples=2, seed=0, labels=None,
):  # fmt: skip
    """Write a results folder; returns the rows as dictionaries."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    labels = labels or dict(zip(planners, planners, strict=True))
    scenes = [f"{preset}_fleet" for preset in presets]
    skill = {name: 1.2 - 2.4 * i / max(len(planners), 2) for i, name in enumerate(planners)}
    rows, robots = [], []
    for scene, preset in zip(scenes, presets, strict=True):
        for team in teams:
            problems = rng.normal(0, 0.7, worlds)
            density = np.maximum(PRESETS[preset] * (1 + 0.25 * rng.normal(size=worlds)), 0)
            for name in planners:
                closed = preset == "dense" and team >= 8 and skill[name] < -0.2
                for world in range(worlds):
                    logit = 2.5 + skill[name] * 1.4 - 12 * density[world] - 0.16 * team
                    hard = logit + problems[world] + rng.normal(0, 0.5)
                    row = dict.fromkeys(SCHEMA.names)
                    row |= {
                        "run": len(rows), "planner": labels[name], "planner_name": name,
                        "scene": scene, "preset": preset, "robots": team,
                        "knows_obstacles": "observed", "knows_current": "nothing",
                        "problem_seed": 7, "world": world, "planned": False, "flown": False,
                        "robots_planned": 0, "robots_reached": 0, "reached": False,
                        "success": False, "density": density[world],
                        "path_ratio": 1 + 4 * density[world] * rng.random(),
                        "free_lines": float(np.exp(-12 * density[world])),
                        "straight_m": 20.0 * team,
                    }  # fmt: skip
                    if preset == presets[0] and team == max(teams) and world == worlds - 1:
                        rows.append(row | {"plan_status": "no room"})
                        continue
                    if closed and world >= 5:
                        rows.append(row | {"plan_status": "closed"})
                        continue
                    planned = not closed and hard > -0.6
                    seconds = 0.02 * team**1.4 * np.exp(0.6 * rng.normal() + 6 * density[world])
                    seconds *= 1 + 3 * (len(planners) > 1) * planners.index(name) / len(planners)
                    seconds = min(seconds, 10.0)
                    row |= {
                        "plan_status": "planned" if planned else ("timeout", "none")[world % 2],
                        "plan_reason": None if planned else "no way was found in time",
                        "planning_s": None if name == "grid" else seconds,
                        "planned": planned, "robots_planned": team if planned else 0,
                    }  # fmt: skip
                    if planned:
                        span = 40 * row["path_ratio"] * (1 + 0.1 * rng.random())
                        span *= 1.25 - 0.2 * skill[name]
                        row |= {
                            "first_s": seconds / 2, "best_s": seconds, "plan_makespan_s": span,
                            "plan_flowtime_s": span * team * 0.8, "plan_turn_rad": 3 * rng.random(),
                            "plan_length_m": 22.0 * team,
                        }  # fmt: skip
                    if planned and flown:
                        won = hard > 0.3
                        row |= {
                            "flown": True, "reached": won, "success": won,
                            "robots_reached": team if won else team - 1,
                            "energy_j": 900 * team * span / 40 * (1 + 0.1 * rng.random()),
                            "path_length_m": 23.0 * team,
                            "min_clearance_m": float(rng.gamma(2, 0.2)) * won,
                            "min_separation_m": float(rng.random()) if team > 1 else None,
                        }  # fmt: skip
                        if won:
                            row |= {
                                "makespan_s": span * 1.05, "flowtime_s": span * team * 0.85,
                                "late_s": 0.05 * span,
                            }  # fmt: skip
                        else:
                            at = rng.normal([3 if preset == "reef" else -4, 1, -8], [3, 5, 2])
                            at = np.clip(at, [-12, -12, -20], [12, 12, 0])
                            end = ENDS[rng.integers(len(ENDS) - (team == 1))]
                            row |= {
                                "failure": end, "failure_time_s": 20.0, "failure_robot": 0,
                                "failure_pair": "cell", "failure_x_m": at[0],
                                "failure_y_m": at[1], "failure_z_m": at[2],
                            }  # fmt: skip
                        robots += _robots(row, team)
                    rows.append(row)
    pq.write_table(pa.Table.from_pylist(rows, SCHEMA), folder / "runs.parquet")
    if flown:
        schema = pa.schema([pa.field("run", pa.int64()), *EPISODE_SCHEMA])
        pq.write_table(pa.Table.from_pylist(robots, schema), folder / "robots.parquet")
    about = {
        "name": "synthetic", "description": "Numbers drawn at random; no flight was made.",
        "created": "2026-01-02T03:04:05Z", "deadline_s": 10.0,
        "host": {"cpu": "none", "cores": 2}, "versions": {"angler-mjx": "0.1.0", "ompl": "2.0"},
        "command": "angler benchmark synthetic.toml --out results",
        "planners": [{"label": labels[n], "name": n, "settings": {"range": 0.5}} for n in planners],
        "scenes": scenes, "teams": list(teams), "complete": flown,
    }  # fmt: skip
    (folder / "about.json").write_text(json.dumps(about))
    for i in range(examples):
        _example(folder / "examples" / f"{i}.npz", scenes[i % len(scenes)], labels, planners, i)
    return rows


def _robots(row, team):
    for robot in range(team):
        failed = not row["success"] and robot == 0
        yield dict.fromkeys(EPISODE_SCHEMA.names) | {
            "run": row["run"], "world": row["world"], "robot": robot, "seed": 7,
            "vehicle": "bluerov2", "parameter_set": "x", "planned": True,
            "outcome": row["failure"] if failed else "reached",
            "failure_x_m": row["failure_x_m"] if failed else None,
            "failure_y_m": row["failure_y_m"] if failed else None,
            "failure_z_m": row["failure_z_m"] if failed else None,
        }  # fmt: skip


def _example(path, scene, labels, planners, seed):
    rng = np.random.default_rng(seed)
    team = 4
    start = np.stack([np.full(team, -10.0), np.linspace(-8, 8, team), np.full(team, -8.0)], 1)
    goal = start * [-1, -1, 1]
    held = {
        "scene": scene, "robots": team, "world": seed, "occupied": rng.random((16, 16, 16)) < 0.02,
        "origin_m": np.array([-12.0, -12.0, -24.0]), "cell_m": 1.5, "floor_z_m": -26.0,
        "start_m": start, "goal_m": goal,
        "obstacle_p_m": np.array([[0.0, 3.0, -8.0], [4.0, -5.0, -9.0]]),
        "obstacle_radius_m": np.array([1.0, 0.7]), "obstacle_moves": np.array([True, False]),
        "planners": np.array([labels[name] for name in planners]),
    }  # fmt: skip
    t = np.linspace(0, 1, 9)
    for k, _ in enumerate(planners):
        bend = 2.5 * rng.normal(size=(team, 1, 3)) * np.sin(np.pi * t)[None, :, None]
        way = start[:, None] + (goal - start)[:, None] * t[None, :, None] + bend
        if k % 5 == 3:
            way[-1] = np.nan
        fine = np.linspace(0, 1, 200)
        flown = np.stack(
            [[np.interp(fine, t, way[r, :, c]) for c in range(3)] for r in range(team)], axis=0
        ).transpose(2, 0, 1) + 0.1 * rng.normal(size=(1, team, 3))
        if k % 4 == 2:
            flown = flown[:0]
        outcome = ["reached"] * team
        if k % 3 == 1 and len(flown):
            outcome[1] = "collision_static"
            flown[90:, 1] = flown[90, 1]
        held |= {
            f"planned_{k}": way, f"time_{k}": np.tile(40 * t, (team, 1)), f"flown_{k}": flown,
            f"outcome_{k}": np.array(outcome),
        }  # fmt: skip
    path.parent.mkdir(exist_ok=True)
    np.savez(path, **held)
