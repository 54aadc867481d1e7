"""Captures a reference from a port, without a running stream, as ``eitskin reference`` does."""

import time
from collections.abc import Iterator

import numpy as np

from eitskin.acquisition.device import Device
from eitskin.acquisition.hotplug import HotPlug
from eitskin.acquisition.ports import open_line
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.errors import BadReference, PortReturned
from eitskin.reference.builder import ReferenceBuilder
from eitskin.reference.captured import DEFAULT_FRAMES, Reference
from eitskin.reference.front_end import stuck
from eitskin.reference.judged import ReferenceChecks
from eitskin.reference.normaliser import normaliser_of, rows_of
from eitskin.reference.scanned import ReferenceScan
from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_proto.wire.volts import SCANS, DriverHello, VoltsView, step_of, table_of_hello, view_of

PATIENCE_S = 10.0
"""Beyond the time that the frames take by themselves."""


def capture(
    port: str,
    frames: int = DEFAULT_FRAMES,
    baud: int = DEFAULT_BAUD,
    *,
    checks: ReferenceChecks | None = None,
    force: bool = False,
    skin: Skin = PAPER,
    scan: ReferenceScan | None = None,
    reconnect_s: float | None = None,
) -> Reference:
    """Return the mean of the next frames of a skin, which must be untouched, and flat or as its scan shows.

    Args:
        port: Serial port's path, ``usb:SERIAL``, or ``NAME:REST`` of a driver.
        frames: Number of frames to average, at least 2.
        baud: Bits per second on a real UART.
        checks: Checks of the reference (:func:`eitskin.reference.judged.reference_checks`); None for no checks.
        force: Accept it even if the sheet was bent, touched or moving.
        skin: The skin of the reference.
        scan: Scan of the sheet in its present shape; None for a flat one.
        reconnect_s: How long to wait for a port that is gone or busy; None does not wait.

    Raises:
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or measures in a way that cannot be used.
        BadReference: The sheet was bent, touched or moving, or nothing is connected, or the frames did not come.
        ValueError: Fewer than 2 frames, or too many.
    """
    ReferenceBuilder(frames)  # raises, before a port is opened
    transport = open_line(port, baud) if reconnect_s is None else HotPlug(port, baud, reconnect_s)
    try:
        device = Device(transport, skin)
        own = not isinstance(device.hello, DriverHello)
        table = ADJACENT_104 if own else rows_of(device.hello) if scan is not None else table_of_hello(device.hello)
        begin = device.start
        while True:
            builder = ReferenceBuilder(frames, skin, scan, table)
            try:
                begin()
                end_s = time.perf_counter() + PATIENCE_S + frames * 1000 / max(device.hello.rate_mHz, 1)
                _collect(device, builder, table, end_s)
                device.stop()
            except PortReturned:
                begin = device.recover
            else:
                return builder.finish(device.hello, checks, force=force)
    finally:
        transport.close()


def whole_frames(device: Device, end_s: float) -> Iterator[FrameView | VoltsView]:
    """Yield whole scans of a device's present configuration as they come; the next one overwrites the view.

    Args:
        device: It streams.
        end_s: ``perf_counter`` at which to stop waiting.
    """
    view = view_of(device.hello)
    while (left_s := end_s - time.perf_counter()) > 0:
        for payload in device.payloads(left_s):
            if payload[0] not in SCANS:
                continue
            try:
                view.load(payload)
            except ProtocolError:
                continue  # not of this device's making
            if view.drives == ALL_DRIVES and view.generation == device.hello.generation:
                yield view


def _collect(device: Device, builder: ReferenceBuilder, table: RowTable, end_s: float) -> None:
    normaliser, own_rows = normaliser_of(device.hello, table), table.id == ADJACENT_104.id
    step = step_of(device.hello) / device.hello.volts_per_count
    why = ""
    for view in whole_frames(device, end_s):
        normaliser.load(view.counts)
        counts = normaliser.counts if step == 1.0 else np.rint(normaliser.counts / step)
        if unfit := "rows are cut off" if view.saturation else stuck(counts, own_rows=own_rows):
            why = f", the last one left out because {unfit}"
            builder.leave_out(unfit)
        elif builder.add(normaliser.voltages()):
            return
    few = f"only {builder.taken} of {builder.frames} frames could be used for the reference{why}"
    if isinstance(device.hello, DriverHello):
        trouble = getattr(device.transport, "trouble", "")
        raise BadReference(f"{few}{f' ({trouble})' if trouble else ''}; check the options of {device.transport.name}")
    raise BadReference(f"{few}; check the current and the gain of the configuration with 'eitskin flash'")
