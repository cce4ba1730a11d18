"""Upload of a mission by MAVLink's mission protocol, paced by the scene's clock."""

from collections.abc import Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import RunError
from angler_sitl.wire.link import MavlinkLink, MavlinkMessage

TIMEOUT_S = 20.0
"""Time without a request after which an autopilot counts as silent."""
_RETRY_S = 2.0
_REQUESTS = ("MISSION_REQUEST_INT", "MISSION_REQUEST")
_RESULTS = {
    number: name.removeprefix("MAV_MISSION_").lower()
    for name, number in vars(dialect).items()
    if name.startswith("MAV_MISSION_") and isinstance(number, int) and "TYPE" not in name
}


@dataclass(frozen=True, kw_only=True)
class UploadItem:
    """Mission item as it is sent; altitudes are relative to home."""

    command: int
    frame: int
    parameters: tuple[float, float, float, float]
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class MissionUpload:
    """Upload of one mission: the autopilot requests item after item, then acknowledges."""

    def __init__(self, link: MavlinkLink, items: Sequence[UploadItem]) -> None:
        """Set up the upload; nothing is sent yet.

        Args:
            link: of the autopilot.
            items: home first.
        """
        self._link, self._items = link, items
        self._answered: MavlinkMessage | None = None
        self._due_s: float | None = None
        self._heard_s = 0.0
        for kind in (*_REQUESTS, "MISSION_ACK"):
            link.latest.pop(kind, None)

    def advance(self, time_s: float) -> bool:
        """Answer a request, if one has come; return whether the mission is uploaded.

        Args:
            time_s: the scene's clock.

        Raises:
            RunError: the autopilot refuses the mission, or is silent.
        """
        link = self._link
        if self._due_s is None:
            self._due_s = self._heard_s = time_s
        ack = link.latest.get("MISSION_ACK")
        if ack is not None:
            if ack.type == dialect.MAV_MISSION_ACCEPTED:
                return True
            result = _RESULTS.get(ack.type, f"result {ack.type}")
            number = 0 if self._answered is None else int(self._answered.seq)
            command = self._items[min(number, len(self._items) - 1)].command
            raise RunError(
                f"{link.name}: refuses the mission at item {number}, command {command} ({result})"
                f"{self._format_texts()}"
            )
        request = next((link.latest[kind] for kind in _REQUESTS if kind in link.latest), None)
        if request is not None and request is not self._answered:
            self._answered, self._heard_s = request, time_s
            if 0 <= request.seq < len(self._items):
                link.send(self._build_item(int(request.seq)))
        elif request is None and time_s >= self._due_s:
            self._due_s = time_s + _RETRY_S
            link.send(dialect.MAVLink_mission_count_message(link.sysid, 1, len(self._items)))
        if time_s > self._heard_s + TIMEOUT_S:
            raise RunError(
                f"{link.name}: requests no mission item for {TIMEOUT_S:g} s of its own clock"
                f"{self._format_texts()}"
            )
        return False

    def _build_item(self, number: int) -> MavlinkMessage:
        item = self._items[number]
        return dialect.MAVLink_mission_item_int_message(
            self._link.sysid,
            1,
            number,
            item.frame,
            item.command,
            int(number == 0),
            1,
            *item.parameters,
            round(item.latitude_deg * 1e7),
            round(item.longitude_deg * 1e7),
            item.altitude_m,
        )

    def _format_texts(self) -> str:
        texts = self._link.format_last_texts()
        return f"; ArduSub says: {texts}" if texts else ""
