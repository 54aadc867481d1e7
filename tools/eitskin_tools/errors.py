"""What the command line raises on purpose, besides the errors of the packages that it calls."""

from eitskin_proto.errors import SkinError


class UsageError(SkinError):
    """An argument that the parser could not judge by itself; exit status 2."""
