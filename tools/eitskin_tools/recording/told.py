"""What a recording says of itself, whichever way its frames are read."""

from abc import ABC, abstractmethod

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.plain import stated
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.wire.answers import Hello
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.reader import Recording


class Told(ABC):
    """Head and device of a recording.

    Args:
        recording: It.

    Raises:
        RecordingError: The device's HELLO cannot be read.
        MismatchError: It is of another protocol.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.path = recording.path
        self.hello = self._hello()

    def told(self, name: str) -> str:
        """Return a text of the head: ``bundle``, ``configuration``, ``serial``, ..."""
        return self.recording.head.get(name, "")

    @abstractmethod
    def reference(self) -> bytes:
        """Return what the first frame is held against of which that is known, as ``eitskin reference`` writes it.

        Raises:
            RecordingError: There is none.
        """

    def _hello(self) -> Hello:
        head = self.recording.head
        protocol = head.get("protocol_id", PROTOCOL_ID)
        hint = "install the release that made the recording ('eitskin --version' names a release's ids)"
        if protocol != PROTOCOL_ID:
            raise MismatchError(f"{self.path}: protocol_id", found=stated(protocol), expected=PROTOCOL_ID, hint=hint)
        try:
            found = Hello.unpack(bytes.fromhex(head.get("hello", "")))
            found.check()
        except MismatchError:
            raise
        except (ValueError, IndexError, SkinError) as error:
            raise RecordingError(f"{self.path}: the device's HELLO cannot be read: {error}") from error
        return found
