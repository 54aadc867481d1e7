"""What ``eitskin subscribe`` shows: as often as a person reads it, with the place of the touch in mm."""

import io
from types import SimpleNamespace

import numpy as np

from eitskin_tools.console.stream_view import StreamView


class Terminal(io.StringIO):
    def isatty(self):
        return True


def frame(number, touched=True, **changes):
    image = np.zeros((30, 45), dtype=np.float32)
    image[9, 13] = 0.93
    fields = {
        "map": image, "touched": touched, "sequence": number, "number": number, "solver": "vd2t-int8",
        "age_s": 0.0013, "counts": {"lost": 4}, "electrodes": (), "events": (),
        "drift_percent": None, "drift_sd_percent": None,
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


def shown(stream, seconds=3.0, rate_hz=200):
    now_s = [0.0]
    view = StreamView(stream, lambda: now_s[0])
    for number in range(int(seconds * rate_hz)):
        now_s[0] = number / rate_hz
        view.show(frame(number))
    view.end()
    return stream.getvalue()


def test_two_hundred_frames_a_second_are_a_line_a_second_in_a_file():
    lines = shown(io.StringIO()).splitlines()
    assert len(lines) == 4  # at 0, 1 and 2 s, and the last frame
    assert lines[-1] == (
        "200.0 frames/s  touched  peak 0.93 at x 45.0, y 31.7 mm  vd2t-int8  age 1.3 ms  lost 4  "
        "drift unknown while touched"
    )


def test_a_terminal_gets_one_line_ten_times_a_second():
    text = shown(Terminal())
    assert text.count("\n") == 1
    assert 28 <= text.count("\r") <= 32
