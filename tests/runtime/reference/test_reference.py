import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin.errors import BadReference, MismatchError
from eitskin.reference import captured as references
from eitskin_proto.skin.skin import PAPER

from .capturing import capture


@pytest.fixture
def frames(counts):
    rng = np.random.default_rng(3)
    return counts * 1e-9 * (1 + 2e-3 * rng.standard_normal((50, 104)))


@pytest.fixture
def captured(frames, hello):
    return capture(frames, hello)


def test_a_reference_is_the_mean_and_the_spread_of_its_frames(captured, frames, hello):
    assert np.allclose(captured.voltages_V, frames.mean(axis=0), rtol=1e-13, atol=0)
    assert np.allclose(captured.spread_V, frames.std(axis=0, ddof=1), rtol=1e-9, atol=0)
    assert (captured.frames, captured.serial_number) == (50, hello.serial_number)


def test_a_stored_reference_comes_back_bit_by_bit(captured, hello, tmp_path):
    path = tmp_path / "skin.json"
    references.save(captured, path)
    found = references.load(path)
    assert np.array_equal(found.voltages_V, captured.voltages_V)
    assert np.array_equal(found.spread_V, captured.spread_V)
    assert found.configuration_digest == hello.configuration_digest
    found.check(hello)


def test_noise_that_rows_share_is_stored_and_comes_back(frames, hello, tmp_path):
    shared = 0.01 * np.random.default_rng(2).standard_normal((50, 1))
    found = capture(frames * (1.0 + shared), hello, force=True)
    assert found.shared_V is not None
    assert found.shared_V.shape == (104, 1)
    assert np.allclose(np.abs(found.shared_V[:, 0]), 0.01 * np.abs(found.voltages_V), rtol=0.5)
    references.save(found, tmp_path / "flat.json")
    again = references.load(tmp_path / "flat.json")
    assert np.array_equal(again.shared_V, found.shared_V)
    assert any("rows share" in line for line in again.report())


def test_a_reference_of_another_device_or_configuration_is_refused_with_the_command(captured, hello):
    with pytest.raises(MismatchError, match=r"serial_number: found TEST-1, expected OTHER; .*eitskin reference"):
        captured.check(replace(hello, serial_number="OTHER"))
    with pytest.raises(MismatchError, match="found paper/0000abcd when it was captured, expected paper/0000"):
        captured.check(replace(hello, configuration_digest=1))


@pytest.mark.parametrize("key", ["protocol_id", "grid_id", "version"])
def test_a_reference_for_another_protocol_grid_or_version_is_refused(captured, tmp_path, key):
    path = tmp_path / "skin.json"
    references.save(captured, path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {key: "feed"}))
    with pytest.raises(MismatchError, match=f"{key}: found feed, expected .*eitskin reference"):
        references.load(path, PAPER)


def test_a_changed_digit_of_any_voltage_is_found(captured, tmp_path):
    path = tmp_path / "skin.json"
    references.save(captured, path)
    lines = path.read_text().splitlines(keepends=True)
    start = lines.index(' "voltages_V": [\n') + 1
    for at in range(start, start + 104):
        digit = lines[at].index(".") + 2
        changed = lines[at][:digit] + str((int(lines[at][digit]) + 1) % 10) + lines[at][digit + 1 :]
        path.write_text("".join([*lines[:at], changed, *lines[at + 1 :]]))
        with pytest.raises(BadReference, match="damaged"):
            references.load(path)


def test_files_that_are_no_references_are_refused(captured, tmp_path):
    path = tmp_path / "skin.json"
    with pytest.raises(BadReference, match="No such file"):
        references.load(path)
    for text in ("", "{", "[]", "{}", '{"format": "eitskin-bundle"}', "[" * 5000, "x" * 70000):
        path.write_text(text)
        with pytest.raises(BadReference):
            references.load(path)


def test_a_crash_while_writing_leaves_the_old_reference(captured, tmp_path, monkeypatch):
    path = tmp_path / "skin.json"
    references.save(captured, path)
    before = path.read_bytes()

    def power_cut(_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", power_cut)
    with pytest.raises(BadReference, match="cannot be written"):
        references.save(replace(captured, frames=7), path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["skin.json"]


def test_a_folder_that_does_not_exist_is_named(captured):
    with pytest.raises(BadReference, match=r"/nowhere/skin\.json"):
        references.save(captured, Path("/nowhere/skin.json"))


def test_weak_rows_are_named_and_counted(frames, hello):
    frames = frames.copy()
    frames[:, 5] = 0.0
    frames[:, 60] *= 1e-4
    found = capture(frames, hello)
    assert found.weak.tolist() == [5, 60]
    line = found.report()[1]
    assert "2 weak rows, filled in from the others" in line
    assert "5 (drive 0, measure 7)" in line


def test_zeros_are_no_reference(hello):
    with pytest.raises(BadReference, match="electrodes are connected"):
        capture(np.zeros((2, 104)), hello)


def test_a_sheet_that_moves_is_no_reference(frames, hello):
    with pytest.raises(BadReference, match=r"vary by 1\d\.\d%.*expected at most 5%"):
        capture(frames * (1 + 0.01 * np.arange(50)[:, None]), hello)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("voltages_V", [1e308] * 104),
        ("voltages_V", ["1"] * 104),
        ("voltages_V", [True] * 103),
        ("frames", 10**400),
        ("frames", True),
        ("serial_number", "\x1b[2Jskin"),
        ("serial_number", None),
        ("configuration_name", "a\nb"),
        ("captured_utc", "x" * 999),
    ],
)
def test_a_sealed_reference_of_impossible_values_is_refused_in_a_line(captured, tmp_path, key, value):
    path = tmp_path / "r.json"
    references.save(captured, path)
    content = {**json.loads(path.read_text()), key: value}
    del content["sha256"]
    path.write_text(json.dumps({**content, "sha256": references.sha256_of_values(content)}))
    with pytest.raises(BadReference) as caught:
        references.load(path)
    assert str(caught.value).isprintable()
