"""Recorded presses become samples beside a data set's, and presses that contradict each other are named."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.normalise import relative_change
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_training.samples import presses
from eitskin_training.samples.joined import join, load_all

RNG = np.random.default_rng(0)
SEEN_AT = RNG.uniform((0.0, 0.0), (150.0, 100.0), (104, 2))
"""Where on the sheet each row sees most."""

REFERENCE = RNG.uniform(0.1, 2.0, 104)
PLACES = np.array([(30.0, 30.0), (75.0, 50.0), (120.0, 70.0), (33.0, 34.0), (75.0, 80.0), (110.0, 20.0)])


def read_at(place: Any) -> Any:
    """Return (104,) V of a press: rows that see the place change by a tenth."""
    away = np.linalg.norm(SEEN_AT - place, axis=1)
    return REFERENCE * np.exp(0.1 * np.exp(-((away / 20.0) ** 2)) + 0.001 * RNG.standard_normal(104))


def recorded(said: Any = PLACES, true: Any = PLACES, reference: Any = REFERENCE) -> Recording:
    """Return presses that were said to be at places, and were elsewhere."""
    pressed = tuple(LaterReading(read_at(b), 40, None, np.array(a), (16.0,)) for a, b in zip(said, true, strict=True))
    return Recording(reference, 100, (), pressed)


@pytest.mark.parametrize(
    ("number", "place", "said"),
    [
        (3, (110.0, 20.0), r"press 0 at \(30, 30\) mm and press 3 at \(33, 34\) mm contradict .* read unlike"),
        (4, (30.0, 30.0), r"press 0 at \(30, 30\) mm and press 4 at \(75, 80\) mm contradict .* read the same"),
    ],
)
def test_presses_that_contradict_each_other_are_named_in_one_line(number: int, place: Any, said: str) -> None:
    true = PLACES.copy()
    true[number] = place
    with pytest.raises(SkinError, match=said) as error:
        presses.check(recorded(true=true))
    assert "\n" not in str(error.value)


def test_too_few_presses_and_rows_that_turned_are_refused() -> None:
    with pytest.raises(SkinError, match="3 presses are recorded, expected at least 4"):
        presses.check(recorded(PLACES[:3], PLACES[:3]))
    turned = REFERENCE.copy()
    turned[7] *= -1.0
    with pytest.raises(SkinError, match="changed its sign"):
        presses.check(recorded(reference=turned))


def test_presses_are_a_fifth_of_what_is_learned_and_some_are_never_learned(tmp_path: Path, toy_data: Any) -> None:
    data = toy_data("area", bends=3)
    presses.write(tmp_path, recorded(), data)
    (alone, again) = (load_all([str(tmp_path)]), presses.load(tmp_path))
    assert alone.digest == again.digest
    both = join([data, alone])
    first = len(data.voltages)
    learned = both.train[both.train >= first] - first
    assert len(learned) / len(both.train) == pytest.approx(presses.PRESS_SHARE, abs=0.05)
    assert sorted(set(learned) | set(presses.held_out_rows(alone))) == list(range(6))
    assert not set(learned) & set(presses.held_out_rows(alone))
    assert not set(both.validation) - set(data.validation)


def test_a_press_shows_the_network_what_the_real_sheet_read_and_where_it_was(tmp_path: Path, toy_data: Any) -> None:
    data, recording = toy_data("area", bends=3), recorded()
    presses.write(tmp_path, recording, data)
    alone = presses.load(tmp_path)
    measured = relative_change(np.array([one.voltages_V for one in recording.presses]), REFERENCE)
    np.testing.assert_allclose(relative_change(alone.voltages, alone.reference), measured, atol=1e-6)
    grid = alone.skin.grid
    length, width = alone.skin.outline.size_mm
    pixel = length * width / grid.n_pixels
    labels = alone.labels.reshape(-1, *grid.shape) / 255.0
    np.testing.assert_allclose(labels.sum(axis=(1, 2)) * pixel, np.pi * 8.0**2, rtol=0.02)
    along = (np.arange(grid.shape[1]) + 0.5) * length / grid.shape[1]
    middle = (labels.sum(axis=1) * along).sum(axis=1) / labels.sum(axis=(1, 2))
    np.testing.assert_allclose(middle, PLACES[:, 0], atol=0.5)


def test_units_and_damaged_files_are_refused(tmp_path: Path, toy_data: Any) -> None:
    with pytest.raises(SkinError, match="bundle of units"):
        presses.write(tmp_path, recorded(), replace(toy_data("area", bends=3), labels_kind="units"))
    np.savez(tmp_path / presses.NAME, labels=np.zeros(3))
    with pytest.raises(SkinError, match=r"presses\.npz is damaged"):
        presses.load(tmp_path)
