"""Presses taken out of a recording."""

from pathlib import Path

import numpy as np
import pytest

from eitskin.messaging.streams.measured import WireFrame
from eitskin_proto.wire.frames import Frame as WireScan
from eitskin_tools import cli
from eitskin_tools.recording.script import Step

from .conftest import PERIOD_NS, counts, measured, recorded

PLACES = [(30.0, 20.0), (75.0, 50.0), (120.0, 80.0), (30.0, 80.0), (120.0, 20.0), (75.0, 20.0), (75.0, 80.0)]
HELD = 50


def response(place: tuple[float, float]) -> np.ndarray:
    return 0.02 * np.cos(np.arange(104) * place[0] / 40.0) * np.sin(np.arange(104) * place[1] / 30.0)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng, steps = np.random.default_rng(3), []
    pushes = [np.zeros(104), *(one for place in PLACES for one in (response(place), np.zeros(104)))]
    for index, push in enumerate(np.repeat(pushes, HELD, axis=0)):
        row = np.rint(counts() * np.exp(push + 1e-4 * rng.standard_normal(104))).astype(np.int32)
        payload = WireScan(100 + index, 1000 + 5000 * index, row).pack()
        steps.append(Step(WireFrame(payload, 100 + index, index * PERIOD_NS), 10**9 + index * PERIOD_NS))
    path = tmp_path_factory.mktemp("presses") / "day.mcap"
    recorded(path, measured(steps=steps))
    return path


def teach(file: Path, places: list[tuple[float, float]], out: Path) -> int:
    file.with_name("places.txt").write_text("".join(f"{x} {y}\n" for x, y in places))
    words = ["--recording", str(file), "--places", str(file.with_name("places.txt")), "--frames", "10"]
    return cli.main(["teach", str(out), "--out", str(out.with_suffix(".eitskin")), *words])


def test_a_recording_with_a_list_of_places_replaces_the_presses_of_an_earlier_one(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "presses.npz"
    teach(file, PLACES[::-1], out)
    teach(file, PLACES, out)
    with np.load(out) as found:
        assert found["xy_mm"][1::2].tolist() == [list(place) for place in PLACES]
        change = np.log(found["voltages_V"][1::2] / found["voltages_V"][::2])
    np.testing.assert_allclose(change, [response(place) for place in PLACES], atol=5e-4)


@pytest.mark.parametrize(("places", "felt"), [(PLACES[:-1], "more"), ([*PLACES, (10.0, 10.0)], "7")])
def test_other_than_one_press_for_each_place_is_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], places: list[tuple[float, float]], felt: str
) -> None:
    assert teach(file, places, tmp_path / "presses.npz") == 1
    assert f"felt {felt} presses" in capsys.readouterr().err
    assert not (tmp_path / "presses.npz").exists()
