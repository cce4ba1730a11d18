"""Films of the gallery: one entry of `FILMS` each."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from angler_mjx.report.video.recording import View
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.shipped import list_shipped

SCENARIOS_FOLDER, RUNS_FOLDER = "scenarios", "runs"
"""Folders of the gallery: scenario files that only it ships, and runs."""


@dataclass(frozen=True, kw_only=True)
class Film:
    """A film: the scenario that is flown, and how one of its worlds is looked at."""

    name: str
    """Name of the files, the run and the section."""
    title: str
    text: str
    """Sentences about what is seen."""
    scenario: str
    """Name of a scenario that `angler rollout` ships, or of one in the folder ``shipped`` here."""
    worlds: int
    engine: str | None = None
    """Physics engine; the scenario's if left out."""
    record_hz: float = 10.0
    view: View = field(default_factory=View)
    poster_s: float
    """Time of the picture that stands for the film, s; the end if the record is shorter."""

    @property
    def scenario_file(self) -> Path | None:
        """The file of a scenario that only the gallery ships; None for the others."""
        return list_shipped(__package__).get(self.scenario)

    @property
    def run(self) -> Path:
        """The run, below the gallery's folder."""
        return Path(RUNS_FOLDER) / self.name

    def load_scenario(self) -> Scenario:
        """Read the scenario as it is flown.

        Raises:
            ConfigError: the file has faults.
        """
        overrides: dict[str, object] = {
            "worlds": self.worlds,
            "time": {"record_hz": self.record_hz},
        }
        if self.engine is not None:
            overrides["engine"] = self.engine
        return load_scenario(self.scenario_file or self.scenario, **overrides)

    def list_commands(self, world: int, poster_s: float) -> Sequence[str]:
        """Return the commands that make the film in the gallery's folder, one a line.

        Args:
            world: index of the world that is shown.
            poster_s: time of the picture, s.
        """
        file = self.scenario_file
        scenario = self.scenario if file is None else f"{SCENARIOS_FOLDER}/{file.name}"
        engine = "" if self.engine is None else f" --engine {self.engine}"
        view, shown = self.view, f"angler replay {self.run} --world {world}"
        camera = f" --camera {view.camera}"
        if view.robot is not None:
            camera += f" --robot {view.robot}"
        camera += " --size {} {}".format(*view.size_px)
        return (
            f"angler rollout {scenario} --worlds {self.worlds}{engine} "
            f"--record-hz {self.record_hz:g} --out {self.run}",
            f"{shown} --video {self.name}.mp4{camera} --speed {view.speed:g}",
            f"{shown} --png {self.name}.png{camera} --at {poster_s:g}",
        )


FILMS: tuple[Film, ...] = (
    Film(
        name="reef",
        title="Four robots cross a reef",
        text="Two vehicles of each of two kinds start at four corners and meet in the middle, "
        "among drifting obstacles, in a current that wanders and eddies behind rock. The camera "
        "follows one of the robots.",
        scenario="reef_fleet",
        worlds=16,
        engine="fused",
        view=View(camera="follow", robot=0),
        poster_s=40.0,
    ),
    Film(
        name="robots_64",
        title="64 robots in one world",
        text="64 vehicles of two kinds start side by side and cross a reef 36 m long. Balls mark "
        "the robots, which are small at this distance, and their goals.",
        scenario="reef_64",
        worlds=4,
        view=View(camera="fixed"),
        poster_s=40.0,
    ),
    Film(
        name="survey_modems",
        title="A survey with modems",
        text="Six robots look at the floor and the rock of a reef until 95 % of it has been seen; "
        "surfaces turn from orange to green. Robots know of each other only what acoustic modems "
        "deliver, in turn, where no rock is between them.",
        scenario="reef_survey_modems",
        worlds=16,
        view=View(camera="fixed"),
        poster_s=60.0,
    ),
    Film(
        name="arm",
        title="A robot reaches with its arm",
        text="Two robots with arms of five joints cross a reef in a current and bring their end "
        "effectors to within 5 cm of their goals, which are the small balls. The camera is before "
        "one of them.",
        scenario="reef_arms",
        worlds=8,
        view=View(camera="follow", robot=1),
        poster_s=81.0,
    ),
    Film(
        name="pipe",
        title="Two robots carry a pipe",
        text="Two robots hold a pipe and bring it three metres down, turned by a quarter. Their "
        "grips bear its weight, drag and inertia, and would break above 150 N.",
        scenario="carry_pipe",
        worlds=4,
        view=View(camera="follow", robot=0),
        poster_s=18.0,
    ),
)
"""All films, in the order of the page. A new film is a new entry, and a file in ``shipped`` if its
scenario ships nowhere else."""
