"""The commands as a user types them: what cannot be shown is one line; what can is seen in a browser, and recorded."""

import os
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest

from eitskin import Frame
from eitskin_proto.skin.skin import PAPER
from eitskin_tools import cli
from eitskin_tools.recording.script import Script
from eitskin_tools.view.source import Source, sources_of
from eitskin_tools.view.viewer import Viewer

from ..recording.conftest import TINY, measured, recorded
from .chromium import PROGRAM
from .conftest import browser, draws_again, picture, pixel, started

CHROMIUM = pytest.mark.skipif(PROGRAM is None, reason="no Chromium: tools/system-packages.sh chromium")


@pytest.fixture(scope="module")
def items():
    """A stream that lasts ten seconds on the clock of its machine, touched in its middle third."""
    found, step_ns = measured(200), 50_000_000
    read = sorted(item.read_ns for item in found if hasattr(item, "read_ns"))
    spread = {read_ns: read[0] + step_ns * taken for taken, read_ns in enumerate(read)}
    for k, item in enumerate(found):
        if hasattr(item, "read_ns"):
            found[k] = replace(item, read_ns=spread[item.read_ns])
        elif isinstance(item, Frame):
            read_ns = spread[item.host_ns["read"]]
            moved = {name: stamp - item.host_ns["read"] + read_ns for name, stamp in item.host_ns.items()}
            found[k] = replace(item, host_ns=moved)
    return found


@pytest.fixture
def path(tmp_path, items):
    ticks = count()
    recorded(tmp_path / "day.mcap", items, now_s=lambda: 0.02 * next(ticks))
    return tmp_path / "day.mcap"


def one_line(capsys, *words):
    """Run a command, and return its status and the one line that it said."""
    status = cli.main(list(map(str, words)))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return status, err


@pytest.mark.parametrize("name", ["https://robot.example.com", "robot:8443", "", "a b"])
def test_an_allowed_host_that_no_request_can_state_is_refused(capsys, name):
    status, said = one_line(capsys, "view", "--no-open", "--allow-host", name)
    assert (status, "expected a name or an address alone" in said) == (2, True)


def test_a_folder_that_takes_no_recordings_is_refused_at_the_start(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    status, said = one_line(capsys, "view", "--recordings", tmp_path)
    assert (status, said) == (
        2, f"eitskin view: --recordings is {tmp_path}, which this user cannot write to; name another folder\n"
    )  # fmt: skip


def test_a_robots_skins_are_found_by_its_file_and_by_its_folder(tmp_path):
    robot = tmp_path / "robot.toml"
    robot.write_text(
        f'format = "eitskin-robot"\nversion = 1\nfolder = "{tmp_path}/s"\n[[skins]]\nname = "arm"\nport = "/dev/x"\n'
        '[[skins]]\nname = "hand"\nport = "/dev/y"\nskin = "lab"\n[skins.pose]\ntranslation_mm = [1, 2, 3]\n'
    )
    arm, hand = sources_of(robot, PAPER)
    assert (arm.name, arm.skin, arm.endpoint) == ("arm", PAPER, f"ipc://{tmp_path}/s/arm/frames")
    assert hand.skin.name != PAPER.name
    assert hand.pose.translation_mm.tolist() == [1.0, 2.0, 3.0]
    from eitskin.robot.config import load_robot
    from eitskin.robot.described import ProcessState, write_states

    (tmp_path / "s").mkdir()
    write_states(tmp_path / "s", 1, [ProcessState(one.skin, "ready") for one in load_robot(robot).skins])
    assert [(one.name, one.endpoint) for one in sources_of(tmp_path / "s", PAPER)] == [
        (one.name, one.endpoint) for one in (arm, hand)
    ]


SEEN = "window.eitskin && eitskin.page.drawings > 0 && eitskin.history?.shown"


@CHROMIUM
@pytest.mark.process
@pytest.mark.slow
def test_any_moment_of_a_recording_is_seen_by_the_bar_and_its_marks(path):
    with started("view", path, "--bundle", TINY, "--port", 0, "--no-open", until="viewing") as line:
        address = next(word for word in line.split() if word.startswith("http"))
        with browser(address) as found:
            found.wait(f"{SEEN} && eitskin.history.share === 1")
            assert found.evaluate("document.getElementById('scrub').max") == "9950"  # the whole file
            assert found.evaluate("eitskin.history.marks().filter((mark) => mark.kind === 'touched').length") == 1
            found.press(" ")
            assert found.evaluate("eitskin.clock.mode") == "paused"
            found.press("n" if found.evaluate("eitskin.clock.at < 3000") else "p")  # to the touch
            found.wait("eitskin.history.ready(eitskin.clock.at) && eitskin.history.shown.head.touches.length")
            at_ms = found.evaluate("eitskin.history.shown.t")
            assert at_ms == pytest.approx(1000 * 200 // 3 * 0.05, abs=60)
            mark_ms = found.evaluate("eitskin.history.marks().find((mark) => mark.kind === 'touched').begin")
            assert (at_ms, found.evaluate("eitskin.history.shown.head.touched")) == (mark_ms, True)
            assert found.evaluate("document.getElementById('bar-words').innerText") == "touched share of a pixel"
            held = found.evaluate("eitskin.history.shown.head.seq")
            found.press(".")
            found.wait(f"eitskin.history.shown.head.seq === {held + 1}")
            found.press(",")
            found.press(",")
            found.wait(f"eitskin.history.shown.head.seq === {held - 1}")
            for t_ms, touched in ((9500, False), (5000, True), (100, False)):  # forth and back
                found.evaluate(
                    f"(() => {{ const s = document.getElementById('scrub'); s.value = {t_ms}; "
                    "s.dispatchEvent(new Event('input')); })()"
                )
                found.wait(f"eitskin.history.ready({t_ms}) && Math.abs(eitskin.history.shown.t - {t_ms}) <= 50")
                found.wait("document.getElementById('state').dataset.state === 'paused'")
                assert found.evaluate("eitskin.history.shown.head.touched") == touched
            found.wait("document.getElementById('when').innerText === '0:00.1 of 0:09.9'")
            found.wait("document.getElementById('live').hidden && document.getElementById('record').hidden")
            draws_again(found)
            marks = found.evaluate("(() => { const b = document.getElementById('marks').getBoundingClientRect(); "
                                   "return [b.left, b.top, b.width]; })()")  # fmt: skip
            shot = picture(found)
            middle, side = ([marks[0] + share * marks[2], marks[1] + 2] for share in (0.5, 0.1))
            assert pixel(shot, middle, 1)[0] < 60, "touched: blue"
            assert pixel(shot, side, 1)[0] > 150, "not touched"
            found.evaluate("document.querySelector('#strip-touches').click()")  # somewhere else
            found.evaluate("eitskin.clock.go(9700), document.activeElement.blur()")
            found.press(" ")
            found.wait("eitskin.clock.mode === 'paused' && eitskin.clock.at === eitskin.clock.end")  # plays to the end
            found.press(" ")
            found.wait("eitskin.clock.mode === 'playing' && eitskin.clock.at < 9000")  # and from the beginning


@CHROMIUM
@pytest.mark.process
@pytest.mark.slow
def test_the_record_button_makes_a_recording_that_can_be_read(path, tmp_path):
    endpoint, folder = f"ipc://{tmp_path}/f", tmp_path / "made"
    folder.mkdir()
    words = ["replay", path, "--bundle", TINY, "--loop", "--publish", endpoint, "--control", f"ipc://{tmp_path}/c"]
    with (
        started(*words, until="ready"),
        Viewer([Source(PAPER, endpoint)], recordings=folder) as viewer,
        browser(viewer.address) as found,
    ):
        found.wait(f"{SEEN} && !document.getElementById('record').hidden")
        found.press("r")
        found.wait("document.getElementById('record').getAttribute('aria-pressed') === 'true'")
        found.wait("document.getElementById('log').innerText.includes('Recording to eitskin-')")
        (made,) = wait_for_frames(folder)
        found.press("r")
        found.wait("document.getElementById('record').getAttribute('aria-pressed') === 'false'")
    script = Script(made)
    assert script.frames > 0
    assert script.ending == ""


def wait_for_frames(folder):
    """Return the files of a folder once the one there has frames."""
    while True:
        files = list(folder.glob("*.mcap"))
        if files and files[0].stat().st_size > 20_000:
            return files
