"""Sessions broken on purpose."""

from dataclasses import replace

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.testing.driving import make_twist


def shift(observation, **changes):
    return replace(observation, **changes)


def broken(borrowed):
    """Sessions with one fault each, by the check that must find it."""

    class Forgetful(borrowed):
        """Stops where no command comes."""

        def step(self, commands=None):
            return super().step(commands or {0: make_twist(0, 0, 0, 0, 0, 0)})

    class Restless(borrowed):
        """Moves on when it is looked at."""

        def observe(self):
            return super().step()

    class Hasty(borrowed):
        """Its clock runs fast."""

        def step(self, commands=None):
            now = super().step(commands)
            return shift(now, time_s=1.5 * now.time_s)

    class Credulous(borrowed):
        """Lets nonsense pass."""

        def check(self, robot, command):
            return None

    class Silent(borrowed):
        """Takes commands for robots that are not there."""

        def step(self, commands=None):
            count = len(self.robots)
            return super().step({i: c for i, c in (commands or {}).items() if 0 <= i < count})

    class Northbound(borrowed):
        """Takes twists along W."""

        def step(self, commands=None):
            turned = {}
            for robot, command in (commands or {}).items():
                u, v, w, p, q, r = np.asarray(command.nu)
                turned[robot] = make_twist(-v, u, w, p, q, r)
            return super().step(turned)

    class Careless(borrowed):
        """Lets a refused robot go on with what it had."""

        def step(self, commands=None):
            good = {}
            for robot, command in (commands or {}).items():
                try:
                    self.check(robot, command)
                    good[robot] = command
                except ConfigError:
                    continue
            return super().step(good)

    class Sudden(borrowed):
        """Gives a plan back at another place."""

        resumed = False

        def resume_plan(self, robot):
            self._session.resume_plan(robot)
            self.resumed = True

        def step(self, commands=None):
            now = super().step(commands)
            return shift(now, target_m=now.target_m + 1.0) if self.resumed else now

    class Immortal(borrowed):
        """Goes on after its end."""

        def close(self):
            return None

    return {
        "commands_are_latched": Forgetful,
        "observing_changes_nothing": Restless,
        "time_advances": Hasty,
        "bad_commands_are_refused": Credulous,
        "robots_that_are_not_there_are_refused": Silent,
        "twists_are_in_the_body_frame": Northbound,
        "a_refused_robot_holds_and_others_go_on": Careless,
        "plans_are_taken_up_again_smoothly": Sudden,
        "a_closed_session_is_closed": Immortal,
    }
