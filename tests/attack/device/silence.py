"""Silence, late and double answers, restarts, and ports that vanish and come back."""

import time
from typing import TYPE_CHECKING, Any, Final

from . import codec
from .hostile import Attack

if TYPE_CHECKING:
    from .process import Machine


class Mute(Attack):
    """Nothing at all, with the port there; what is asked is read and not answered."""

    def send(self, payload: bytes) -> bool:
        return True

    def request(self, payload: bytes) -> bool:
        return True


class Deaf(Attack):
    """Frames go on; nothing that is asked is answered."""

    def request(self, payload: bytes) -> bool:
        return True


class Unheard(Attack):
    """What is asked is done, but the answer never comes."""

    def send(self, payload: bytes) -> bool:
        return payload[0] in (codec.ACK, codec.HELLO, codec.TIME)


class Pause(Attack):
    """Now and then half a packet, silence, and the other half: every frame is whole in the end."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        self._rest = b""
        self._at_s = 0.0

    def send(self, payload: bytes) -> bool:
        data = codec.packet(payload)
        if self._rest:
            self._rest += data
        elif self.random.random() < 0.1:
            at = self.random.randrange(1, len(data))
            self.machine.put(data[:at])
            self._rest, self._at_s = data[at:], time.monotonic() + self.random.choice((0.01, 0.1, 0.4))
        else:
            return False
        return True

    def idle(self) -> None:
        if self._rest and time.monotonic() >= self._at_s:
            self._flush()
        super().idle()

    def end(self) -> None:
        self._flush()
        super().end()

    def _flush(self) -> None:
        self.machine.put(self._rest)
        self._rest = b""


class Late(Attack):
    """Answers come late, twice, with another tag first, or as somebody else's: ``kind`` says which."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        self._held: list[tuple[float, bytes]] = []

    def send(self, payload: bytes) -> bool:
        if payload[0] not in (codec.ACK, codec.HELLO, codec.TIME, codec.CONFIG_DATA):
            return False
        data = codec.packet(payload)
        other = codec.packet(payload[:1] + bytes((payload[1] ^ 0x55,)) + payload[2:])
        match self.order["kind"]:
            case "late":
                self._held.append((time.monotonic() + self.order.get("by_s", 0.3), data))
            case "twice":
                self.machine.put(data + data)
                self._held.append((time.monotonic() + 0.5, data))
            case "tagged":
                self.machine.put(other + data + other)
            case kind:
                raise ValueError(kind)
        return True

    def idle(self) -> None:
        while self._held and self._held[0][0] <= time.monotonic():
            self.machine.put(self._held.pop(0)[1])
        super().idle()


class Restart(Attack):
    """Boots again and again, as a device with a bad supply does; the numbers begin anew each time."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        self._times = order.get("times", 1)
        self._next_s = 0.0

    def idle(self) -> None:
        if self._times and time.monotonic() >= self._next_s:
            self._times -= 1
            self._next_s = time.monotonic() + self.order.get("apart_s", 0.5)
            self.machine.restart()
        elif not self._times:
            self.end()


class Vanish(Attack):
    """The port goes, in the middle of a packet, and comes back under its name; the device has restarted meanwhile."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        data = codec.packet(machine.last or machine.device.hello(0))
        machine.put(data[: len(data) // 2])
        machine.line.push()
        machine.line.close()
        self._until_s = time.monotonic() + order.get("seconds", 1.0)

    def idle(self) -> None:
        if time.monotonic() >= self._until_s:
            self.end()

    def end(self) -> None:
        self.machine.line.open()
        self.machine.put(b"\0")
        self.machine.restart()
        super().end()


KNOWN: Final[dict[str, type[Attack]]] = {
    "mute": Mute,
    "deaf": Deaf,
    "unheard": Unheard,
    "pause": Pause,
    "late": Late,
    "restart": Restart,
    "vanish": Vanish,
}
