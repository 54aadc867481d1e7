"""The commands of control requests, and the checks of their fields."""

import time
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin.errors import ControlError, SkinError
from eitskin.messaging.unpacking import require, unpacked
from eitskin.reference.captured import DEFAULT_FRAMES
from eitskin_proto.fields import Fields
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.skin import Skin as SkinDescription

LARGEST_REQUEST: Final = 32768
"""Bytes to a runtime of the paper's skin; a cloud with both predictions has 18,000. libzmq drops a client that sends
more, before it takes memory."""

REFERENCE_FRAMES: Final = (2, 10_000)
"""Fewest and most frames of a requested reference."""

WAITING_COMMANDS: Final = ("reference",)
"""Commands that wait for frames."""

Request = Mapping[str, Any]
Answer = Mapping[str, object]


def largest_request(grid: Grid) -> int:
    """Return the same for any skin: as much more as its clouds are larger."""
    return LARGEST_REQUEST + 12 * max(0, grid.n_pixels - PAPER.grid.n_pixels)


def unpack_fields(parts: list[bytes], largest: int = LARGEST_REQUEST) -> dict[str, Any]:
    """Return the map of a message.

    Args:
        parts: Of the message.
        largest: Bytes.

    Raises:
        ControlError: It is no map, or too large.
    """
    if len(parts) != 1:
        raise ControlError(f"a message of {len(parts)} parts; expected one")
    what = "a MessagePack map"
    return unpacked(
        parts[0], what, largest=largest, longest_text=2048, longest_list=64, longest_map=64, error=ControlError
    )


class Controlled(Protocol):
    """The server's interface to the runtime; called in the server's threads, never in the frame loop's."""

    def use_cloud(
        self,
        cloud: npt.NDArray[np.floating] | None,
        predicted: npt.NDArray[np.float64] | None = None,
        predicted_flat: npt.NDArray[np.float64] | None = None,
    ) -> tuple[int, tuple[str, ...]]:
        """Use a cloud from the next frame on, and return its revision and warnings."""

    def recapture(self, frames: int, *, force: bool = False) -> Mapping[str, object]:
        """Replace the reference by the mean of the next frames, and return it with its findings.

        It is called in a thread of its own, one call at a time; the other methods may be called meanwhile. ``stop``
        must end it.
        """

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Go on without these electrodes from the next frame on."""

    def status(self) -> Mapping[str, object]:
        """Return counters and ids."""

    def stop(self) -> None:
        """End the frame loop soon."""


class Commands:
    """Performs requests.

    Args:
        controlled: The runtime.
        skin: The skin whose clouds it accepts.
    """

    def __init__(self, controlled: Controlled, skin: SkinDescription) -> None:
        self._controlled, self._skin = controlled, skin
        self._table: dict[str, Callable[[Request], Answer]] = {
            "cloud": self._cloud,
            "reference": self._reference,
            "exclude": self._exclude,
            "status": lambda _: self._controlled.status(),
            "clock": lambda _: {"now_ns": time.perf_counter_ns()},
            "stop": self._stop,
        }

    def prepare(self, parts: list[bytes]) -> tuple[Callable[[], Answer], bool]:
        """Return the function that performs a request, and whether it waits for frames.

        Args:
            parts: Of the message, without its envelope.

        Raises:
            ControlError: It is no request.
        """
        request = unpack_fields(parts, largest_request(self._skin.grid))
        command = request.get("command")
        if not isinstance(command, str) or command not in self._table:
            raise ControlError(
                f"command {str(command)[:40]!r} does not exist; expected one of {', '.join(self._table)}"
            )
        return lambda: self._table[command](request), command in WAITING_COMMANDS

    def _cloud(self, request: Request) -> Answer:
        fields = Fields(request, "", error=ControlError)
        digest = request.get("skin_digest")
        if digest is not None:
            grid_id, hint = request.get("grid_id"), "send a cloud of the runtime's skin ('eitskin surface --skin FILE')"
            check_made_for("the cloud", self._skin, grid_id=grid_id, skin_digest=digest, hint=hint)
        if request.get("cloud") is None:
            raise ControlError("a cloud request needs the field 'cloud'")
        cloud = fields.array("cloud", "<f4", self._skin.grid.cloud_shape)
        predicted, flat = (
            None if request.get(name) is None else fields.array(name, "<f8", (N_ROWS,))
            for name in ("predicted", "predicted_flat")
        )
        revision, doubts = self._controlled.use_cloud(cloud, predicted, flat)
        return {"cloud": revision, "warnings": list(doubts)}

    def _reference(self, request: Request) -> Answer:
        low, high = REFERENCE_FRAMES
        fields = Fields(request, "", error=ControlError)
        frames = fields.whole("frames", DEFAULT_FRAMES, low=low, high=high)
        force = fields.truth("force", False)
        return self._controlled.recapture(frames, force=force)

    def _exclude(self, request: Request) -> Answer:
        fields = Fields(request, "", error=ControlError)
        require(fields, "electrodes")
        electrodes = fields.wholes("electrodes", high=N_ELECTRODES - 1)
        self._controlled.exclude(electrodes)
        return {"electrodes": list(electrodes)}

    def _stop(self, _: Request) -> Answer:
        self._controlled.stop()
        return {}


def answer_of(perform: Callable[[], Answer]) -> tuple[bool, bytes]:
    """Return whether a request was granted, and the packed answer; whatever it brings about, it is an answer."""
    try:
        answer: dict[str, object] = {"ok": True, **perform()}
        packed: bytes = msgpack.packb(answer)
    except (SkinError, ValueError, TimeoutError) as error:
        return False, refusal(str(error))
    except Exception as error:  # the next request must find a server
        return False, refusal(f"the runtime failed at this request: {type(error).__name__}")
    return True, packed


def refusal(why: str) -> bytes:
    """Return the packed answer to a request that is refused."""
    packed: bytes = msgpack.packb({"ok": False, "error": " ".join(why.split())[:1000]})
    return packed
