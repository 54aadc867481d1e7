"""A reference captured of frames."""

from eitskin.reference.builder import ReferenceBuilder
from eitskin_proto.skin.skin import PAPER


def capture(frames, hello, checks=None, *, scan=None, force=False):
    """Return the reference of (n, rows) V."""
    builder = ReferenceBuilder(len(frames), PAPER, scan)
    assert [builder.add(frame) for frame in frames] == [False] * (len(frames) - 1) + [True]
    return builder.finish(hello, checks, force=force)
