"""A stand-in for ArduSub: a real process that speaks its protocol, with the traps of the real one.

It has no physics, no filter and no controllers. What it has: the same command line; lock-step by
servo packets and text replies; zeros on the thrusters while it boots; the same packet again where
no reply comes; a parser that wants no space after a colon; death by NaN; SIGTERM noted while it
waits; a reboot in place with a new source port; and the MAVLink messages that a session needs:
those of `stand_in_talk`. Thrusters: passthrough where SERVOn_FUNCTION asks for it; elsewhere 1500
while disarmed and then channel n of the RC override.

Its own parameters, by --defaults like all others, make it misbehave at a time of its own clock:
STANDIN_EXIT_S (ends with code 3), STANDIN_HANG_S (stays and does nothing), STANDIN_REBOOT_S,
STANDIN_NO_EKF 1 (never becomes ready), STANDIN_NO_ARM 1 (refuses to arm). STANDIN_PORT is the port
that it sends from in its first STANDIN_PORT_STARTS starts in a folder.
"""

import argparse
import math
import os
import re
import signal
import socket
import struct
import sys
import time

from stand_in_talk import Line, Talk

RESEND_S = 1.1
MAGIC = 18458
ZERO_FROM_S, ZERO_TO_S = 0.03, 1.75
NEEDED = {"timestamp": 1, "gyro": 3, "accel_body": 3, "position": 3, "velocity": 3}
BUILT_IN = {"ARMING_CHECK": 448.0, "FRAME_CONFIG": 1.0, "SIM_RATE_HZ": 1200.0, "SYSID_THISMAV": 1.0}


class StandIn:
    def __init__(self, given):
        self.given = given
        self.parameters = dict(BUILT_IN)
        for name in filter(None, (given.defaults or "").split(",")):
            self._read(name)
        if given.sysid:
            self.parameters["SYSID_THISMAV"] = float(given.sysid)
        self.time_s = self.began_s = None
        self.frame, self.state, self.term = 0, {}, False
        signal.signal(signal.SIGTERM, self._on_term)

    def _read(self, name):
        with open(name) as file:
            for line in file:
                words = line.split("#")[0].replace(",", " ").split()
                if len(words) == 2:
                    self.parameters[words[0]] = float(words[1])

    def _on_term(self, *_):
        self.term = True  # acted on after a step only

    def run(self):
        print(f"Setting SYSID_THISMAV={self.parameters['SYSID_THISMAV']:g}", flush=True)
        print("Starting sketch 'ArduSub'", flush=True)
        with open("eeprom.bin", "wb") as file:
            file.write(bytes(16384))
        os.makedirs("logs", exist_ok=True)
        base = self.given.base_port + 10 * self.given.instance
        lines = Line(self.given.serial0, base), Line(self.given.serial1, base + 2)
        self.talk = Talk(self.parameters, lines, self._reboot)
        self.fdm = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # As the firmware does: whatever port the kernel gives, and others may have it too.
        self.fdm.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.fdm.bind(("127.0.0.1", self._port()))
        self.where = ("127.0.0.1", self.given.sim_port_out)
        print(f"JSON control interface set to {self.where[0]}:{self.where[1]}", flush=True)
        while True:
            self._exchange()
            self.frame += 1
            if self.term:
                sys.exit(0)
            self._misbehave()
            self.talk.step(self.age_s, self.time_s, self.state)

    def _port(self):
        if "STANDIN_PORT" not in self.parameters:
            return 0
        with open("starts", "a") as file:
            file.write("x")
        early = os.path.getsize("starts") <= self.parameters["STANDIN_PORT_STARTS"]
        return int(self.parameters["STANDIN_PORT"]) if early else 0

    @property
    def age_s(self):
        return 0.0 if self.time_s is None else self.time_s - self.began_s

    def _exchange(self):
        rate = int(self.parameters["SIM_RATE_HZ"])
        packet = struct.pack("<HHI16H", MAGIC, rate, self.frame, *self._pwm())
        while True:
            self.fdm.sendto(packet, self.where)
            end = time.monotonic() + RESEND_S
            while (left := end - time.monotonic()) > 0:
                self.fdm.settimeout(left)
                try:
                    text = self.fdm.recv(65536).decode(errors="replace")
                except OSError:
                    break
                if self._accept(text):
                    return
            print("No JSON sensor message received, resending servos", flush=True)

    def _accept(self, text):
        """Take a reply; False where the firmware could not read it."""
        found = {}
        for key, length in NEEDED.items():
            numbers = _numbers(text, key, length)
            if numbers is None:
                print(f"Failed to find key {key}", flush=True)
                return False
            found[key] = numbers
        found["quaternion"] = _numbers(text, "quaternion", 4)
        if found["quaternion"] is None or text[-1] != "\n":
            print("Did not receive all mandatory fields", flush=True)
            return False
        if not all(map(math.isfinite, found["gyro"] + found["accel_body"])):
            print("ERROR: Floating point exception - aborting", flush=True)
            os.abort()
        now = found["timestamp"][0]
        if self.time_s is None or now < self.time_s:
            if self.time_s is not None:
                print("Detected physics reset", flush=True)
            self.began_s = now - self.age_s if self.time_s is not None else now
        self.time_s, self.state = now, found
        return True

    def _pwm(self):
        if ZERO_FROM_S < self.age_s < ZERO_TO_S:
            return [0] * 8 + [1000] * 8
        override, thrusters = self.talk.override, []
        for n in range(8):
            function = int(self.parameters.get(f"SERVO{n + 1}_FUNCTION", 33 + n))
            if 51 <= function <= 66:  # as it is: armed or not, 0 while none came
                thrusters.append(override[function - 51])
            else:
                thrusters.append((override[n] or 1500) if self.talk.armed else 1500)
        return thrusters + [1000] * 8

    def _misbehave(self):
        late = {n for n, v in self.parameters.items() if n.endswith("_S") and 0 < v <= self.age_s}
        if "STANDIN_EXIT_S" in late:
            print("stand-in: told to end", flush=True)
            sys.exit(3)
        while "STANDIN_HANG_S" in late:
            time.sleep(60)
        if "STANDIN_REBOOT_S" in late and "REBOOTED" not in os.environ:
            self._reboot()

    def _reboot(self):
        os.environ["REBOOTED"] = "1"
        print("stand-in: reboot", flush=True)
        os.execv(sys.executable, [sys.executable, *sys.argv])


def _numbers(text, key, length):
    """Numbers behind a key, or None. The key's first place counts, as in the firmware."""
    at = text.find(f'"{key}":')
    if at < 0:
        return None
    pattern = r"[-+0-9.eEnainfNI]+"
    rest = text[at + len(key) + 3 :]
    shape = pattern if length == 1 else r"\[" + r", ?".join([pattern] * length)
    found = re.match(shape, rest)
    return None if found is None else [float(word) for word in re.findall(pattern, found[0])]


def main():
    parser = argparse.ArgumentParser(allow_abbrev=False)
    for name in ("--model", "--home", "--defaults"):
        parser.add_argument(name)
    parser.add_argument("--wipe", action="store_true")
    parser.add_argument("-I", "--instance", type=int, default=0)
    parser.add_argument("--sysid", type=int)
    parser.add_argument("--base-port", type=int, default=5760)
    parser.add_argument("--sim-port-out", type=int, default=9002)
    parser.add_argument("--rc-in-port", type=int, default=5501)
    parser.add_argument("--serial0", default="tcp:0:wait")
    for n in (1, 2, 5):
        parser.add_argument(f"--serial{n}", default="none:")
    given = parser.parse_args()
    if not (given.model or "").startswith("JSON"):
        print("You must specify a vehicle model.")
        sys.exit(1)
    StandIn(given).run()


if __name__ == "__main__":
    main()
