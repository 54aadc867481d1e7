"""Other makers' electronics from a port's name to frames, with fakes behind pseudo-terminals."""

import itertools
import os
import re
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import eitskin
from eitskin.acquisition.capture import capture
from eitskin.acquisition.device import Device
from eitskin.acquisition.drivers import driver_line, text_line
from eitskin.acquisition.drivers.driver import driver_name
from eitskin.acquisition.hotplug import HotPlug
from eitskin.acquisition.ports import open_line
from eitskin_proto.sensor.row_table import ADJACENT_104, named, row_map
from eitskin_proto.sensor.table import RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.wire.volts import view_of

from .fake_electronics import FakeSciospec, K, Lines, M

NOISE = 2e-3


def untouched():
    """Return (208,) V of a reciprocal sheet, which span a factor of 300."""
    half = 1e-2 * 300.0 ** (-np.arange(104) / 103)
    whole = np.zeros(208)
    whole[ROW_IN_FULL] = whole[RECIPROCAL_IN_FULL] = half
    return whole


def at_rest(number):
    return untouched() * (1.0 + NOISE * np.random.default_rng(number).standard_normal(208))


def own_rows(voltages):
    return 0.5 * (voltages[..., ROW_IN_FULL] + voltages[..., RECIPROCAL_IN_FULL])


def pyeit_order(voltages):
    order = named("pyeit-208").electrodes.astype(int)
    where = {(k, m): row for row, (k, m) in enumerate(zip(K, M, strict=True))}
    return [-voltages[where[k, n]] for k, _, _, n in order]


def matrix(voltages):
    whole = np.zeros((16, 16))
    whole[K, M] = np.abs(voltages)
    return whole.ravel()


def text(numbers, digits="{:.6e}", joint=", "):
    return joint.join(digits.format(number) for number in numbers)


def pairs(voltages):
    turned = voltages * np.exp(0.7j)
    return text(np.stack([turned.real, turned.imag], axis=1).ravel())


FORMS = {
    "104 numbers": (lambda v: text(own_rows(v)), ""),
    "208 numbers": (text, ""),
    "pyEIT's order": (lambda v: text(pyeit_order(v), joint=" "), "?order=pyeit"),
    "a matrix of amounts with a label": (lambda v: "magnitudes: " + text(matrix(v)) + ",", "?values=amounts"),
    "complex pairs": (pairs, "?values=complex&numbers=208"),
    "millivolts": (lambda v: text(1e3 * v, "{:.7f}"), "?scale=0.001"),
}


@pytest.mark.parametrize("kind", FORMS)
def test_each_way_of_printing_a_scan_gives_the_same_reference(kind):
    form, options = FORMS[kind]
    with Lines(at_rest, form) as device:
        found = capture(f"line:{device.port}{options}", 40)
    mine, mapped = np.abs(found.voltages_V), row_map(found.table, ADJACENT_104, signed=False)
    rows = np.zeros(104)
    rows[:] = mine if mapped is None else 0.0
    if mapped is not None:
        mapped.apply(mine, rows)
    np.testing.assert_allclose(rows, own_rows(untouched()), rtol=6 * NOISE / np.sqrt(40))


def test_a_sciospec_device_is_set_up_by_its_answers_and_gives_its_rows():
    with FakeSciospec(at_rest, 200.0) as device:
        found = capture(f"sciospec:{device.port}?rate=40&current=0.002", 20)
        sequence = [command[3:5] for command in device.commands if command[:3] == b"\xb0\x03\x06"]
    assert found.table.id == named("adjacent-208").id
    assert sequence == [bytes([k + 1, (k + 1) % 16 + 1]) for k in range(16)]
    np.testing.assert_allclose(own_rows(found.voltages_V), own_rows(untouched()), rtol=6 * NOISE / np.sqrt(20))


def test_sciopy_reads_the_same_fake():
    sciopy = pytest.importorskip("sciopy", reason="sciopy is not installed")
    with FakeSciospec(lambda number: untouched()) as device:
        theirs = sciopy.EIT_16_32_64_128(16)
        theirs.connect_device_FS(device.port, timeout=1)
        theirs.setup = sciopy.EitMeasurementSetup(
            burst_count=3, n_el=16, exc_freq=20e3, framerate=40, amplitude=1e-3, inj_skip=0, gain=1, adc_range=1
        )
        theirs.cMessageParser.set_measurement_setup(theirs.setup)
        potentials = np.array(theirs.StartStopMeasurement(timeout=1, return_as="pot_mat"))[0]
    found = np.abs(potentials[K, M] - potentials[K, (M + 1) % 16])
    np.testing.assert_allclose(found, untouched(), rtol=5e-3)  # float32 of potentials a hundred times the smallest row


def scans(line, count):
    """Return a device behind a line, and the first scans after its start."""
    device = Device(line)
    device.start()
    view, found = view_of(device.hello), []
    while len(found) < count:
        for payload in device.payloads(10.0):
            if payload[0] == 0xF0:
                view.load(payload)
                found.append((view.sequence, view.device_us, view.counts.copy()))
    return device, found


def scans_left(line):
    """Read until the line is gone."""
    while True:
        line.read(10.0)


def test_a_scan_that_lacks_a_message_counts_as_lost_and_none_is_put_together_of_two():
    with FakeSciospec(at_rest) as device:
        device.skip = {3, 4}
        line = open_line(f"sciospec:{device.port}")
        _, found = scans(line, 8)
        line.close()
    sequence = [number for number, _, _ in found]
    assert sequence == [1, 2, 3, 6, 7, 8, 9, 10]
    assert np.diff([us for _, us, _ in found]).tolist() == [25_000, 25_000, 75_000, 25_000, 25_000, 25_000, 25_000]


def test_settings_belong_to_the_reference(tiny):
    with Lines(at_rest, text) as device:
        found = capture(f"line:{device.port}", 10)
        with pytest.raises(eitskin.MismatchError, match="the device's configuration"):
            eitskin.Skin(f"line:{device.port}?scale=2", bundle=tiny, reference=found)


def touched_from(first, amount=0.3):
    """Return the voltages of a sheet that is touched from a scan on; the pattern is that of the tiny bundle's tests."""
    pattern = np.zeros(208)
    pattern[ROW_IN_FULL] = pattern[RECIPROCAL_IN_FULL] = np.cos(np.arange(104))
    return lambda number: at_rest(number) * (1.0 + amount * pattern * (number >= first))


def test_a_network_takes_rows_in_any_order_and_maps_are_those_of_its_own(tiny):
    """The rows of a foreign device give the same dV as the same voltages in the project's order."""
    still = np.array([at_rest(number) for number in range(60)])
    mine = eitskin.Skin(source=eitskin.Feed(), bundle=tiny, reference=own_rows(still))
    theirs = eitskin.Skin(
        source=eitskin.Feed("pyeit-208"), bundle=tiny, reference=np.array([pyeit_order(one) for one in still])
    )
    with mine, theirs:
        for number in range(60, 70):
            volts = touched_from(60)(number)
            one, other = mine.feed(own_rows(volts)), theirs.feed(pyeit_order(volts))
            assert one.touched
            assert other.touched
            np.testing.assert_allclose(one.map, other.map, rtol=1e-5, atol=1e-6)
        assert mine.status()["frames"] == 10


def test_a_program_that_feeds_late_loses_no_scan(tiny):
    still = np.array([own_rows(at_rest(number)) for number in range(60)])
    with eitskin.Skin(source=eitskin.Feed(), bundle=tiny, reference=still) as skin:
        assert skin.feed(own_rows(at_rest(60)), 1_000_000) is not None
        time.sleep(0.2)  # twice what a device's first frame may wait
        assert skin.feed(own_rows(at_rest(61)), 1_005_000) is not None


def test_a_time_may_be_a_float_and_nan_is_refused_where_it_is_put_in():
    feed = eitskin.Feed()
    feed.put(np.ones(104), 1e6 + 5000.0)
    assert next(feed.scans()).device_us == 1_005_000
    with pytest.raises(ValueError, match="NaN"):
        feed.put(np.ones(104), float("nan"))


def test_an_iterable_ends_with_its_last_scan(tiny):
    def stream():
        for number in range(40):
            go.acquire()
            yield own_rows(at_rest(number))

    def count(skin):
        for frames, _ in enumerate(skin.frames(), 1):
            counted.append(frames)
            go.release()

    go, counted = threading.Semaphore(2), []
    reference = np.array([own_rows(at_rest(number)) for number in range(100, 140)])
    ended = pytest.raises(eitskin.PortLost, match="iterable ended: it has no more scans")
    with eitskin.Skin(source=stream(), bundle=tiny, reference=reference) as skin, ended:
        count(skin)
    assert counted[-1] >= 38  # the newest of those that waited is the first


class Polled:
    """A device that measures on request."""

    name, serial_number, settings, table = "polled", "P1", {"gain": 2}, ADJACENT_104
    rate_hz, step_V, full_scale_V, signed = 0.0, 0.0, 0.0, True

    def __init__(self, measure):
        self.measure = measure
        self.closed = False

    def start(self):
        pass

    def stop(self):
        pass

    def close(self):
        self.closed = True


def test_a_polled_driver_needs_no_descriptor(tiny):
    device = Polled(lambda: own_rows(at_rest(np.random.default_rng().integers(1 << 30))))
    with eitskin.Skin(source=device, bundle=tiny) as skin:
        skin.capture_reference(20, force=True)
        assert not next(skin.frames()).touched
        assert "rate unknown" not in "".join(skin.transport.report())  # one scan was timed
    assert device.closed


class FakeCn0565:
    """pyadi-iio's board of this name: counts (real, imaginary) for each (force +, sense +, sense -, force -)."""

    def __init__(self, uri):
        self.uri = uri

    @property
    def switch_sequence(self):
        rows = [(k, m, (m + 1) % 16, (k + 1) % 16) for k in range(16) for m in range(16)]
        return np.array([row for row in rows if len({*row}) == 4])

    @property
    def all_voltages(self):
        where = {(k, m): row for row, (k, m) in enumerate(zip(K, M, strict=True))}
        volts = at_rest(np.random.default_rng().integers(1 << 30))
        counts = 1e6 * np.exp(0.7j) * volts[[where[k, m] for k, m, _, _ in self.switch_sequence]]
        return np.stack([counts.real, counts.imag], axis=1)

    def close(self):
        self.uri = ""


def test_a_cn0565_is_read_by_its_makers_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "adi", None)
    with pytest.raises(eitskin.TransportError, match=r"cn0565 needs pyadi-iio .* pip install pyadi-iio"):
        open_line("cn0565:ip:board")
    monkeypatch.setitem(sys.modules, "adi", SimpleNamespace(cn0565=FakeCn0565))
    found = capture("cn0565:ip:board?frequency=20000", 40)
    mapped, rows = row_map(found.table, ADJACENT_104, signed=False), np.zeros(104)
    mapped.apply(np.abs(found.voltages_V), rows)
    np.testing.assert_allclose(rows, own_rows(untouched()), rtol=6 * NOISE / np.sqrt(40))


def test_a_converter_of_ten_bits_makes_a_reference_and_a_stuck_one_does_not(tiny, monkeypatch):
    step = untouched().max() / 500.0

    def coarse(voltages):
        return text(np.rint(voltages / step) * step)

    def stuck(voltages):
        return text(np.where(np.arange(208) % 3, 200, np.rint(voltages / step)) * step)

    with Lines(at_rest, coarse) as device:
        assert capture(f"line:{device.port}?step={step}", 50).spread_V.any()
    still = np.rint([at_rest(number) / step for number in range(50)]) * step
    with eitskin.Skin(source=eitskin.Feed("adjacent-208", step_V=step), bundle=tiny, reference=still) as skin:
        assert all(skin.feed(still[0]) is not None for _ in range(4))  # scans of so coarse a converter may repeat
    monkeypatch.setattr(sys.modules[capture.__module__], "PATIENCE_S", 2.0)  # before 200 frames were left out
    with Lines(at_rest, stuck, 50.0) as device, pytest.raises(eitskin.BadReference, match="rows share counts"):
        capture(f"line:{device.port}?step={step}&rate=50", 50)


# What goes wrong, in one line


def test_a_driver_that_hangs_is_named(tiny, monkeypatch):
    hangs = threading.Event()
    first = iter([own_rows(at_rest(number)) for number in range(30)])

    def measure():
        found = next(first, None)
        if found is None:
            hangs.wait(60)
            return own_rows(at_rest(0))
        return found

    reference = np.array([own_rows(at_rest(number)) for number in range(100, 140)])
    try:
        with (
            eitskin.Skin(source=Polled(measure), bundle=tiny, reference=reference) as skin,
            pytest.raises(eitskin.HandshakeError, match="polled sends no scans: nothing came; check its cable"),
        ):
            list(skin.frames())
    finally:
        hangs.set()


def test_a_driver_that_lies_about_its_rate_is_named(monkeypatch):
    monkeypatch.setattr(driver_line, "RATE_CHECK_S", 0.2)
    with Lines(at_rest, text, rate_hz=200.0) as device:
        line = open_line(f"line:{device.port}?rate=1000")
        with pytest.raises(eitskin.HandshakeError, match="says that it sends 1000 scans/s, but sends"):
            scans(line, 1000)
        line.close()


def test_a_device_that_vanishes_is_named():
    with Lines(at_rest, text) as device:
        line = open_line(f"line:{device.port}")
        scans(line, 2)
        device.vanish()
        with pytest.raises(eitskin.PortLost, match=f"{device.port} vanished"):
            scans_left(line)
        line.close()


def test_a_driver_waits_for_a_board_that_boots_and_goes_on_after_an_unplug(tiny, tmp_path, monkeypatch):
    """The board prints text first; after the unplug it is another pseudo-terminal behind the same name."""
    monkeypatch.setattr(text_line, "PROBE_S", 0.2)

    def boot(voltages):
        return text(voltages) if booted.is_set() else "boot 3 of 7\r\n115200"

    booted, link = threading.Event(), tmp_path / "ttyACM0"
    reference = np.array([at_rest(number) for number in range(100, 140)])
    with Lines(at_rest, boot) as device:
        link.symlink_to(device.port)
        line = HotPlug(f"line:{link}?step=1e-9", give_up_s=60.0)
        assert "sent no line of numbers" in line.trouble
        booted.set()
        with eitskin.Skin(line, bundle=tiny, reference=reference) as skin, Lines(at_rest, text) as again:
            frames = skin.frames()
            next(frames)
            assert "rate unknown" not in "".join(line.report())
            device.vanish()
            link.unlink()
            link.symlink_to(again.port)
            assert any("recovered" in frame.events for frame in frames)
            assert line.returns == 1


def test_a_reference_waits_for_its_port(tmp_path):
    with Lines(at_rest, text) as device:
        threading.Timer(0.2, (tmp_path / "late").symlink_to, [device.port]).start()
        assert capture(f"line:{tmp_path}/late", 10, reconnect_s=60.0).frames == 10


def test_half_frames_are_counted_as_lost():
    numbers = itertools.count()

    def form(voltages):
        number = next(numbers)
        if number == 30:
            return text(voltages).replace(", ", ", nan, ", 1)[: len(text(voltages))].rpartition(",")[0]
        return text(voltages[:100] if number in (20, 21) else voltages)

    with Lines(at_rest, form, rate_hz=50.0) as device:
        line = open_line(f"line:{device.port}?numbers=208&rate=50")
        _, found = scans(line, 40)
        line.close()
    steps = np.diff([number for number, _, _ in found]).tolist()
    assert (steps.count(3), steps.count(2)) == (1, 1)


@pytest.mark.parametrize(
    ("last", "trouble"),
    [("1, nan, 3", "had 3 numbers, expected 208"), (", ".join(["1", "nan", *["2"] * 206]), "column 2 .* is 'nan'"),
     ("", "it stopped after [1-9][0-9]* lines, [0-9]+ s ago")],
)  # fmt: skip
def test_a_device_that_sends_nothing_useful_any_more_is_described(last, trouble):
    broken = threading.Event()
    with Lines(at_rest, lambda voltages: last if broken.is_set() else text(voltages)) as device:
        line = open_line(f"line:{device.port}?numbers=208&rate=200")
        scans(line, 20)
        broken.set()
        while line.read(0.5):
            pass
        assert re.search(trouble, line.trouble)
        line.close()


def started(port):
    """Open a port and start its device."""
    line = open_line(port)
    try:
        Device(line).start()
    finally:
        line.close()


@pytest.mark.parametrize(
    ("port", "error", "text"),
    [
        ("nobody:/dev/x", eitskin.TransportError, "no driver is called 'nobody'; there are cn0565, line, sciospec"),
        ("line:/dev/none", eitskin.PortMissing, "no port /dev/none: plug the device in"),
        ("line:{port}?colour=3", eitskin.TransportError, "colour"),
        ("line:{port}?numbers=208&order=opposite-192", eitskin.TransportError, "208 numbers, expected the 192 rows"),
        ("sciospec:{port}?rate=0", eitskin.TransportError, "sciospec rate is 0, expected"),
        ("sciospec:{port}", eitskin.HandshakeError, "did not acknowledge the"),
    ],
)
def test_a_port_that_cannot_be_used_says_why(port, error, text, monkeypatch):
    monkeypatch.setattr("eitskin.acquisition.drivers.sciospec.ACK_S", 0.3)
    with Lines(at_rest, globals()["text"]) as device, pytest.raises(error, match=text):
        started(port.format(port=device.port))


def test_two_tables_are_refused(tiny):
    wrong = np.array([at_rest(number)[:192] for number in range(10)])
    with pytest.raises(eitskin.MismatchError, match="found opposite-192, expected adjacent-104"):
        eitskin.Skin(source=eitskin.Feed("opposite-192"), bundle=tiny, reference=wrong)
    with Lines(at_rest, text) as device:
        found = capture(f"line:{device.port}?order=rows-208", 10)
    with pytest.raises(eitskin.MismatchError, match="reference: its rows: found rows-208"):
        found.in_table(ADJACENT_104)


def test_a_reference_keeps_its_table(tmp_path):
    with Lines(at_rest, text) as device:
        found = capture(f"line:{device.port}", 10)
    eitskin_file = tmp_path / "r.json"
    from eitskin.reference.captured import load, save

    save(found, eitskin_file)
    assert load(eitskin_file).table.id == named("adjacent-208").id


def test_paths_with_a_colon_and_usb_ports_are_no_drivers():
    assert driver_name("/dev/serial/by-id/usb-1:1.2") == driver_name("usb:SKIN") == driver_name("/dev/ttyACM0") == ""
    assert driver_name("line:/dev/ttyACM0?numbers=256") == "line"


def test_standard_input_is_a_port(tmp_path):
    lines = "".join(text(own_rows(at_rest(number))) + "\n" for number in range(50))
    read, write = os.pipe()
    os.write(write, lines[: 1 << 15].encode())
    kept = os.dup(0)
    try:
        os.dup2(read, 0)
        line = open_line("line:-")
        _, found = scans(line, 5)
        os.close(write)
        with pytest.raises(eitskin.PortLost, match="standard input ended"):
            scans_left(line)
        line.close()
    finally:
        os.dup2(kept, 0)
        for file in (read, kept):
            os.close(file)
    np.testing.assert_allclose(found[0][2], own_rows(at_rest(0)), rtol=1e-6)
    assert sys.stdin is not None
