"""The root of every error that eitskin raises on purpose.

::

    SkinError
    └── ProtocolError          bytes, a file or a device that does not speak this protocol
        └── MismatchError      the right kind of thing, but made for another protocol_id or grid_id

The runtime grows its own branches in :mod:`eitskin.errors`. Bad arguments are plain ``ValueError``.
"""


class SkinError(Exception):
    """An error that eitskin detected; the message says what was found, what was expected and what to do."""


class ProtocolError(SkinError):
    """Bytes, a file or a device that does not speak this protocol."""


class MismatchError(ProtocolError):
    """An artefact made for another protocol or grid.

    Args:
        what: The artefact, with the name of the field that differs.
        found: The value that it carries.
        expected: The value that this installation needs.
        hint: The command that fixes it.
    """

    def __init__(self, what: str, *, found: object, expected: object, hint: str) -> None:
        super().__init__(f"{what}: found {found}, expected {expected}; {hint}")
        self.found = found
        self.expected = expected
