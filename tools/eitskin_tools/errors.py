"""The errors of the command line itself."""

from eitskin_proto.errors import SkinError


class UsageError(SkinError):
    """An argument that the parser could not judge by itself; exit status 2."""
