"""All channels of a recording, in the order of their numbers.

Every file has all of them, so that a number means the same channel in each, also where the chunk that says so is lost.
"""

from typing import Final

from eitskin_tools.recording.layout import CLOUD, CONDITIONS, FRAME, MAP, STATE, WIRE
from eitskin_tools.recording.pictures import GRID, SURFACE

CHANNELS: Final = (WIRE, CLOUD, STATE, CONDITIONS, FRAME, MAP, GRID, SURFACE)

TOPICS: Final = {number: channel.topic for number, channel in enumerate(CHANNELS, start=1)}
"""Topic by number."""
