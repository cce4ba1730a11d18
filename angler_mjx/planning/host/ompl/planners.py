"""OMPL's geometric planners by their names, each with its settings.

Importing this needs no OMPL: settings can be read and checked anywhere. A planner of it is made
where it plans, in a worker process.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import ClassVar

from angler_mjx.errors import UnsupportedError
from angler_mjx.planning.host.ompl import settings as of
from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.planning.problem import Problem

type Progress = list[tuple[float, float]]

_PLANNING = "angler_mjx.planning.host.ompl.planning"


class OmplPlanner:
    """One of OMPL's planners for a team; its subclasses are named after OMPL's.

    The same problem, settings and machine give the same plan, unless the clock ends the search:
    planners that go on improving are ended by it, if not by ``edge_limit`` or ``first``.
    """

    NAME: ClassVar[str]
    """OMPL's."""
    Settings: ClassVar[type[of.OmplSettings]] = of.OmplSettings

    def __init__(self, settings: of.OmplSettings | None = None) -> None:
        """Keep the settings and prepare OMPL.

        Args:
            settings: an instance of its ``Settings``; the defaults if left out.

        Raises:
            ConfigError: a setting is out of its bounds.
            UnsupportedError: OMPL or a library that it needs is not installed.
        """
        self.settings = self.Settings() if settings is None else settings
        of.check_settings(self.NAME, self.settings)
        try:
            planning = import_module(_PLANNING)
        except ModuleNotFoundError as error:
            raise UnsupportedError(
                f"planner {self.NAME} needs {error.name}: pip install 'angler-mjx[plan]'"
            ) from error
        planning.begin()
        self._planned: Callable[..., tuple[list[Path | NoPlan], dict[str, float], Progress]] = (
            planning.planned
        )
        self._warm_up: Callable[..., None] = planning.warm_up
        self.extras: dict[str, float] = {}
        """Of the last plan: ``setup_s`` (of the checks), ``search_s``, ``first_s`` (to OMPL's first
        path), ``best_s`` (to the last that was better), ``best_cost`` (length in the space of the
        team), checked ``edges``, ``simplify_s``, ``delay_s`` (waited at the start), ``attempts``.
        One by one, sums over robots."""
        self.progress: Progress = []
        """Of the last plan: each time that OMPL had a better path, seconds since its search began
        and ``best_cost``, up to 1,000. One by one a team has no such row, and none is here."""

    def warm_up(self, problem: Problem) -> None:
        """Compile the functions that planning such problems needs."""
        self._warm_up(self.NAME, self.settings, problem)

    def plan(self, problem: Problem) -> Sequence[Path | NoPlan]:
        """Return a path of each robot; see `angler_mjx.planning.planner.Planner`."""
        self.extras, self.progress = {}, []
        paths, self.extras, self.progress = self._planned(self.NAME, self.settings, problem)
        return paths


class OmplRRTConnect(OmplPlanner):
    """RRT-Connect: two trees that grow towards each other; ends with its first path."""

    NAME = "RRTConnect"
    Settings = of.RRTConnectSettings


class OmplRRT(OmplPlanner):
    """RRT; ends with its first path."""

    NAME = "RRT"
    Settings = of.RRTSettings


class OmplRRTstar(OmplPlanner):
    """RRT*; goes on improving."""

    NAME = "RRTstar"
    Settings = of.RRTstarSettings


class OmplInformedRRTstar(OmplPlanner):
    """Informed RRT*; goes on improving."""

    NAME = "InformedRRTstar"
    Settings = of.RRTstarSettings


class OmplSORRTstar(OmplPlanner):
    """RRT* with samples in order of their promise; goes on improving."""

    NAME = "SORRTstar"
    Settings = of.RRTstarSettings


class OmplBITstar(OmplPlanner):
    """Batch informed trees; goes on improving."""

    NAME = "BITstar"
    Settings = of.BITstarSettings


class OmplAORRTC(OmplPlanner):
    """RRT-Connect again and again, in the space of state and cost; goes on improving."""

    NAME = "AORRTC"
    Settings = of.AORRTCSettings


class OmplPRM(OmplPlanner):
    """A roadmap; ends with its first path."""

    NAME = "PRM"
    Settings = of.PRMSettings


class OmplPRMstar(OmplPlanner):
    """A roadmap with as many neighbours as its optimum needs; goes on improving."""

    NAME = "PRMstar"
    Settings = of.PRMstarSettings


class OmplFMT(OmplPlanner):
    """Fast marching tree over one batch of samples."""

    NAME = "FMT"
    Settings = of.FMTSettings


class OmplBFMT(OmplPlanner):
    """Fast marching trees from both ends."""

    NAME = "BFMT"
    Settings = of.FMTSettings


class OmplKPIECE1(OmplPlanner):
    """KPIECE over a random projection; ends with its first path."""

    NAME = "KPIECE1"
    Settings = of.KPIECE1Settings


class OmplBKPIECE1(OmplPlanner):
    """KPIECE from both ends."""

    NAME = "BKPIECE1"
    Settings = of.BKPIECE1Settings


class OmplLBKPIECE1(OmplPlanner):
    """KPIECE from both ends, which looks at edges only when they join."""

    NAME = "LBKPIECE1"
    Settings = of.LBKPIECE1Settings


PLANNERS: dict[str, type[OmplPlanner]] = {
    each.NAME: each
    for each in (
        OmplRRTConnect,
        OmplRRT,
        OmplRRTstar,
        OmplInformedRRTstar,
        OmplSORRTstar,
        OmplBITstar,
        OmplAORRTC,
        OmplPRM,
        OmplPRMstar,
        OmplFMT,
        OmplBFMT,
        OmplKPIECE1,
        OmplBKPIECE1,
        OmplLBKPIECE1,
    )
}
"""By OMPL's names."""
