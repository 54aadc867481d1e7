"""The scans of another maker's device in a recording: as they came, played again, computed again."""

from itertools import count
from pathlib import Path

import numpy as np

import eitskin
from eitskin.messaging.frame import Frame
from eitskin_proto.sensor.row_table import named
from eitskin_proto.sensor.table import RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.wire.volts import VOLTS_TYPE
from eitskin_tools.recording.script import Script

from .conftest import TINY, Taker, play, recorded


def test_foreign_scans_are_recorded_and_played_as_they_came(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)

    def whole(touch: float) -> np.ndarray:
        voltages, own = np.zeros(208), 1e-2 * np.geomspace(1.0, 3e-3, 104) * (1.0 + touch * np.cos(np.arange(104)))
        voltages[ROW_IN_FULL] = voltages[RECIPROCAL_IN_FULL] = own
        return voltages * (1.0 + 1e-3 * rng.standard_normal(208))

    taker, feed = Taker(), eitskin.Feed("adjacent-208", serial_number="LAB-7")
    untouched = np.array([whole(0.0) for _ in range(30)])
    made = [whole(0.3 * (20 <= index < 40)) for index in range(60)]
    with eitskin.Skin(source=feed, bundle=TINY, reference=untouched) as skin:
        skin.loop.source.begin()
        feed.put(made[0], 0)
        for index, _ in zip(count(1), skin.publish(taker), strict=False):
            if index == len(made):
                break
            feed.put(made[index], 25_000 * index)
    path = tmp_path / "foreign.mcap"
    recorded(path, taker.items)

    script = Script(path)
    wires = [one.frame for one in script.steps()]
    assert script.hello.table.id == named("adjacent-208").id
    assert len(wires) == 60
    assert all(one.payload[0] == VOLTS_TYPE for one in wires)
    before = [one for one in taker.items if isinstance(one, Frame)]
    after = [one for one in play(path) if isinstance(one, Frame)]
    assert [one.touched for one in after] == [one.touched for one in before]
    assert sum(one.touched for one in before) == 20
    for one, again in zip(before, after, strict=True):
        np.testing.assert_array_equal(one.map, again.map)
