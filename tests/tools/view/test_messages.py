"""Messages to the page, with the sheet and its colours."""

import numpy as np
from tests.tools.view.unpacking import unpacked

from eitskin.robot.pose import Pose
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.messages import electrode_places_mm, packed, skin_message


def test_a_message_cut_anywhere_is_no_message_yet():
    message = packed({"kind": "frame", "text": "ä"}, b"\0\xff")
    assert unpacked(message) == [({"kind": "frame", "text": "ä"}, b"\0\xff")]
    assert [unpacked(message[:end]) for end in range(len(message))] == [[]] * len(message)
    assert len(unpacked(message * 3 + message[:-1])) == 3


def test_electrodes_lie_on_the_border_at_their_arc_length():
    places = electrode_places_mm(PAPER)
    assert places[0].tolist() == [12.5, 0.0]
    assert places[5].tolist() == [150.0, 18.75]
    assert places[8].tolist() == [137.5, 100.0]
    assert places[15].tolist() == [0.0, 18.75]
    x, y = places.T
    on_border = np.minimum(np.minimum(x, 150 - x), np.minimum(y, 100 - y))
    assert np.abs(on_border).max() == 0.0


def test_the_colours_can_be_told_apart_without_hue():
    from eitskin_tools.pictures import palette

    linear = (palette() / 255.0) ** 2.2
    lightness = 116 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16
    assert np.diff(lightness).min() > 0.5  # each level is lighter than the one before, in any kind of colour blindness
    assert lightness[-1] - lightness[0] > 80
    (head, _) = unpacked(skin_message(PAPER, 0, Pose(), {"name": ""}))[0]
    assert head["palette"][0] == palette()[0].tolist()
