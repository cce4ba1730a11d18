"""A control law that commands what the grip measures, as a file of a user."""

from angler_mjx.robot.control.commands import BodyTwist, BodyWrench


class EchoLaw:
    """A control law that commands what the grip measures."""

    takes, gives, wants_grip = (BodyTwist,), BodyWrench, True

    def step(self, gains, memory, inputs, command):
        return memory, BodyWrench(tau=inputs.estimate.grip.wrench)
