"""Files that are not there: every command names the one it was given, in one line, and says what would do."""

import errno
import os

import pytest

from eitskin_tools import cli
from eitskin_tools.command_line import files

ABSENT = "nothere"
"""Name of a file that is not there."""

TAKING_A_FILE = {
    "pair": ["pair", ABSENT, "free", "--out", "x.eitskin"],
    "card": ["card", ABSENT],
    "card --out": ["card", "free", "--out", f"{ABSENT}/x.eitskin"],
    "pair SMALL": ["pair", "free", ABSENT, "--out", "x.eitskin"],
    "flash write": ["flash", "write", ABSENT, "--port", "/dev/null"],
    "flash diff": ["flash", "diff", ABSENT, "--port", "/dev/null"],
    "virtual-skin --config": ["virtual-skin", "--config", ABSENT],
    "virtual-skin --scene": ["virtual-skin", "--scene", ABSENT],
    "virtual-skin --log": ["virtual-skin", "--log", f"{ABSENT}/log"],
    "demo --bundle": ["demo", "--bundle", ABSENT],
    "run --bundle": ["run", "--port", "/dev/null", "--bundle", ABSENT],
    "run --skin": ["run", "--port", "/dev/null", "--skin", ABSENT],
    "run --reference": ["run", "--port", "/dev/null", "--reference", ABSENT],
    "reference --show": ["reference", "--show", ABSENT],
    "reference --out": ["reference", "--port", "/dev/null", "--out", f"{ABSENT}/reference.json"],
    "surface": ["surface", ABSENT, "--out", "cloud.npz"],
    "simulate": ["simulate", ABSENT, "--out", "v.npz"],
    "simulate --out": ["simulate", "sample", "--out", f"{ABSENT}/v.npz"],
    "evaluate --phantoms": ["evaluate", "--phantoms", ABSENT],
    "evaluate --bundle": ["evaluate", "--random", "2-4", "--bundle", ABSENT],
    "doctor --recorded": ["doctor", "--electrodes", "--recorded", ABSENT],
    "subscribe --server-key": ["subscribe", "--server-key", ABSENT, "--client-key", ABSENT],
    "calibrate --surface": ["calibrate", "r.npz", "--guided", "--port=/dev/null", "--out=s.toml", "--surface", ABSENT],
    "bench tradeoff": ["bench", "tradeoff", "--phantoms", ABSENT],
}
"""Every way to give a command a file, without torch."""


def said(capsys, words):
    assert cli.main(words) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    assert "[Errno" not in err
    return err


@pytest.mark.parametrize("words", TAKING_A_FILE.values(), ids=TAKING_A_FILE)
def test_a_file_that_is_not_there_is_named_in_one_line(capsys, monkeypatch, tmp_path, words):
    monkeypatch.chdir(tmp_path)
    assert ABSENT in said(capsys, words)


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (FileNotFoundError(errno.ENOENT, "no", "x.json"), "no file 'x.json' in"),
        (FileNotFoundError(errno.ENOENT, "no", "/none/x.json"), "no folder '/none' for '/none/x.json'"),
        (PermissionError(errno.EACCES, "no", "/etc/passwd"), "file of this user: 'ls -ld /etc/passwd' shows its owner"),
        (PermissionError(errno.EACCES, "no", "/proc/none/x"), "a folder of this user: 'ls -ld /proc' shows its owner"),
        (IsADirectoryError(errno.EISDIR, "no", "x"), "'x' is a folder; expected a file"),
        (NotADirectoryError(errno.ENOTDIR, "no", "x/y"), "found a file where a folder was expected"),
        (FileExistsError(errno.EEXIST, "no", "x"), "'x' exists already"),
        (OSError(errno.ENOSPC, "no", "x"), "no space left for 'x'"),
        (OSError(errno.EFBIG, "File too large", "x"), "'x': the file would be larger than this user may write"),
        (OSError(errno.EMFILE, "Too many open files"), "allow more with 'ulimit -n'"),
        (OSError(errno.EIO, "Input/output error", b"x"), "'x' cannot be used: Input/output error"),
    ],
)
def test_an_error_of_the_system_becomes_a_line_that_names_the_file(error, expected):
    assert expected in (files.explain(error) or "")


@pytest.mark.parametrize("name", ["simulate --out"])
def test_a_folder_that_takes_no_files_is_said_before_the_work(name, capsys, monkeypatch):
    words = [word.replace(ABSENT, "/proc") for word in TAKING_A_FILE[name]]
    monkeypatch.setattr("os.access", lambda path, _: str(path) != "/proc")  # root may write nearly everywhere
    assert "cannot be written: this user may not write to its folder" in said(capsys, words)


WRITING = {
    "pair": ["pair", "free", "press", "--out"],
    "card": ["card", "free", "--out"],
    "simulate": ["simulate", "sample", "--out"],
    "surface": ["surface", "sample", "--out"],
    "reference": ["reference", "--port", "/dev/null", "--out"],
    "record": ["record", "--out"],
    "reinfer --out": ["reinfer", ABSENT, "--out"],
    "plot": ["plot", ABSENT, "--out"],
    "convert": ["convert", ABSENT, "--format", "npz", "--out"],
    "calibrate": ["calibrate", ABSENT, "--out"],
    "calibrate --guided": ["calibrate", "--guided", "--port", "/dev/null", "--out", ABSENT],
    "bench tradeoff --plot": ["bench", "tradeoff", "--phantoms", "paper_units", "--plot"],
    "virtual-skin --wire-times": ["virtual-skin", "--seconds=1", "--wire-times"],
    "virtual-skin --log": ["virtual-skin", "--seconds=1", "--log"],
}
"""Every way to name a file that is written, without torch; the name comes last."""

WRITING_WITH_TORCH = {
    "build": ["build", "paper", "--out"],
    "adapt-skin": ["adapt-skin", "press", "--skin", "lab", "--out"],
    "export": ["export", ABSENT, "--out"],
}

FILLING = {
    "dataset": ["dataset", "--set", "paper", "--out"],
    "service": ["service", "--out"],
}
"""Every way to name a folder that is filled, likewise."""

FILLING_WITH_TORCH = {
    "train": ["train", "--recipe", "tiny", "--data", ABSENT, "--out"],
}

NEEDING_TORCH = WRITING_WITH_TORCH | FILLING_WITH_TORCH
EVERY_WRITING = WRITING | FILLING | NEEDING_TORCH


def identity(path):
    """Return what would differ if something else stood there."""
    found = path.lstat()
    return found.st_ino, found.st_mode, found.st_mtime_ns


def made(node, folder):
    path = folder / "out.png"
    if node == "a FIFO":
        os.mkfifo(path)
    elif node == "a folder":
        path.mkdir()
    elif node == "a file":
        path.touch()
    else:
        path.symlink_to("/dev/null")
    return path


def taken(command):
    """Return the words of a command, whose last is to come; skip what cannot run here."""
    if command in NEEDING_TORCH:
        pytest.importorskip("torch", reason="training needs the extra 'train'")
    return EVERY_WRITING[command]


@pytest.mark.parametrize("command", WRITING | WRITING_WITH_TORCH)
@pytest.mark.parametrize("node", ["a FIFO", "a folder", "a device"])
def test_a_target_that_is_no_regular_file_is_named_before_any_work(command, node, tmp_path, capsys):
    path = made(node, tmp_path)
    before = identity(path)
    assert f"{path} is {node}, expected a regular file" in said(capsys, [*taken(command), str(path)])
    assert identity(path) == before


@pytest.mark.parametrize("command", [name for name in WRITING | WRITING_WITH_TORCH if name[-4:] in ("plot", "ture")])
def test_a_picture_that_cannot_be_drawn_is_refused_before_any_work(command, tmp_path, capsys):
    assert "ends in '.npz', expected one of .png" in said(capsys, [*taken(command), f"{tmp_path}/x.npz"])


@pytest.mark.parametrize("command", FILLING | FILLING_WITH_TORCH)
@pytest.mark.parametrize("node", ["a FIFO", "a file", "a device"])
def test_a_target_that_is_no_folder_is_named_before_any_work(command, node, tmp_path, capsys):
    path = made(node, tmp_path)
    before = identity(path)
    assert f"{path} is {node}, expected a folder" in said(capsys, [*taken(command), str(path)])
    assert identity(path) == before
