"""Pixels of the time strips, of scenes whose every number is known."""

from itertools import pairwise

import numpy as np
import pytest

from eitskin.frame_record import STAGES

from .chromium import PROGRAM
from .conftest import browser, draws_again, ink, picture
from .scripted import Runtime, Scene, disc

pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium: tools/system-packages.sh chromium"),
]

TOUCHED = disc(110.0, 30.0, 8.0)
SHOWN = "window.eitskin && eitskin.page.drawings > 0 && eitskin.history.newest"
PAD = {"left": 34, "right": 2, "top": 7, "bottom": 15}
"""Of a strip, in CSS pixels: static/strips.js."""
PHASE_MS = 3000
"""How long each half of the strips' scene lasts: 15 of their pixels."""


def nice(value):
    """Return the next of 1, 2, 5 times a power of ten, as an axis ends."""
    power = 10.0 ** np.floor(np.log10(value))
    return power * next(step for step in (1, 2, 5, 10) if step * power >= value * 0.999)


def columns(found, shot, strip, begin_ms, end_ms):
    """Return (rows, columns, 3): a strip from one time to another."""
    left, top, width, height, begin, end = found.evaluate(
        f"(() => {{ const b = document.getElementById('{strip}').getBoundingClientRect(), w = "
        "eitskin.history.window(b.width); return [b.left, b.top, b.width, b.height, w.begin, w.end]; })()"
    )
    room = width - PAD["left"] - PAD["right"]
    ends = [round(left + PAD["left"] + (t - begin) / (end - begin) * room) for t in (begin_ms, end_ms)]
    return shot[round(top) : round(top + height), ends[0] : ends[1] + 1]


def line_rows(strip, colour):
    """Return of each column the mean row of its pixels of a colour, NaN without one."""
    like = np.abs(strip - colour).max(axis=2) < 60
    rows = np.arange(len(strip))[:, None]
    return np.where(like.any(axis=0), (like * rows).sum(axis=0) / np.maximum(like.sum(axis=0), 1), np.nan)


def row_of(height, value, low, high):
    """Return the row in which a strip shows a value."""
    return height - PAD["bottom"] - (value - low) / (high - low) * (height - PAD["top"] - PAD["bottom"])


def test_the_strips_show_when_it_was_touched_what_was_lost_how_long_it_took_and_the_drift(viewer, endpoint):
    spans = Scene().spans_us
    with browser(viewer.address) as found:
        with Runtime(endpoint, Scene(drift=(0.4, 0.1, 0.2))) as runtime:
            found.wait(f"{SHOWN} && eitskin.history.end - eitskin.history.begin > {PHASE_MS}")
            changed_ms = found.evaluate("eitskin.history.end")
            runtime.scene = Scene(TOUCHED, drift=(2.0, 0.1, 0.2), counts=(7, 0, 0, 0))
            found.wait(f"eitskin.history.newest.head.touches.length && eitskin.history.end > {changed_ms + PHASE_MS}")
        found.wait("document.getElementById('state').dataset.state === 'silent'")  # now nothing moves
        found.evaluate("eitskin.page.slowAt = 0")
        draws_again(found)
        shot, end_ms = picture(found), found.evaluate("eitskin.history.end")
        area = found.evaluate("eitskin.history.newest.head.touches[0].area")
        before, after = (changed_ms - 2000, changed_ms - 700), (end_ms - 1800, end_ms - 500)

        strips = {"touches": ("s1", 0.0, area, 0.0, nice(area)), "drift": ("s3", 0.4, 2.0, -1.0, nice(2.1))}
        for name, (colour, low_value, high_value, low, high) in strips.items():
            for span, value in ((before, low_value), (after, high_value)):
                strip = columns(found, shot, f"strip-{name}", *span)
                rows = line_rows(strip, ink(found, colour))
                assert np.isfinite(rows).all(), (name, span)
                np.testing.assert_allclose(rows, row_of(len(strip), value, low, high), atol=2.0, err_msg=name)

        strip = columns(found, shot, "strip-latency", *after)
        total_ms = sum(spans) / 1000
        top = row_of(len(strip), total_ms, 0.0, nice(1.1 * total_ms))
        filled = np.abs(strip - ink(found, "card")).max(axis=2) > 70
        assert filled[round(top) + 2 : len(strip) - PAD["bottom"] - 2].mean() > 0.9
        assert filled[PAD["top"] + 3 : round(top) - 2].mean() < 0.1

        strip = columns(found, shot, "strip-losses", changed_ms - 1100, end_ms)  # a bar is of a whole second
        lost = np.abs(strip - ink(found, "s4")).max(axis=2) < 60
        tall = row_of(len(strip), 0.0, 0.0, nice(7)) - row_of(len(strip), 7.0, 0.0, nice(7))
        assert lost.sum(axis=0).max() == pytest.approx(tall, abs=2.0)
        strip = columns(found, shot, "strip-losses", changed_ms - 2500, changed_ms - 1100)
        assert not (np.abs(strip - ink(found, "s4")).max(axis=2) < 60).any()


def test_each_stage_has_its_own_colour_in_its_place_in_the_strip_and_its_name_beside_it(viewer, endpoint):
    spans = (100, 150, 120, 200, 130, 180)  # us, each some rows of the strip
    ends = np.cumsum([0, *spans]) / 1000
    with browser(viewer.address) as found:
        with Runtime(endpoint, Scene(spans_us=spans)):
            found.wait(f"{SHOWN} && eitskin.history.end - eitskin.history.begin > 2500")
        found.wait("document.getElementById('state').dataset.state === 'silent'")  # now nothing moves
        found.evaluate("eitskin.page.slowAt = 0")
        draws_again(found)
        shot, end_ms = picture(found), found.evaluate("eitskin.history.end")
        strip = columns(found, shot, "strip-latency", end_ms - 1800, end_ms - 500)
        inks = [ink(found, f"s{k + 1}") for k in range(len(spans))]
        assert min(np.abs(a - b).max() for k, a in enumerate(inks) for b in inks[:k]) > 30
        for k, (begin, end) in enumerate(pairwise(ends)):
            row = round(row_of(len(strip), (begin + end) / 2, 0.0, nice(1.1 * ends[-1])))
            bare = 0.9 * inks[k] + 0.1 * ink(found, "card")
            np.testing.assert_allclose(strip[row], np.tile(bare, (strip.shape[1], 1)), atol=12, err_msg=STAGES[k + 1])
        legend = found.evaluate(
            "[...document.getElementById('stages').children].map((entry) => [entry.innerText, "
            "getComputedStyle(entry.querySelector('i')).backgroundColor])"
        )
        coloured = [f"rgb({', '.join(str(int(value)) for value in one)})" for one in inks]
        assert legend == [list(pair) for pair in zip(STAGES[1:], coloured, strict=True)]
