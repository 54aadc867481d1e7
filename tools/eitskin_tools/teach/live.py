"""Records presses: of a person who is led through them, or out of a recording."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from eitskin_proto.sensor.row_table import RowTable
from eitskin_proto.skin.skin import Skin
from eitskin_tools.guided import Silent
from eitskin_tools.teach.guide import PressGuide, PressRecorder, places_of
from eitskin_tools.teach.places import Place, grid_places


def lead_through(path: Path, skin: Skin, port: str, baud: int, *, presses: int, frames: int, page: int | None) -> None:
    """Record presses on a grid, and write each to a file as it comes; what the file holds already is kept.

    Args:
        path: The file.
        skin: Its sheet is pressed.
        port: Of the device.
        baud: Bits per second of a UART.
        presses: About how many.
        frames: That a reading is the mean of.
        page: Port of the page that shows the next place; None for no page.

    Raises:
        SkinError: The device cannot be used, the person gave up, or the file holds other presses.
        OSError: The file cannot be written.
    """
    from eitskin.acquisition.device import Device
    from eitskin.acquisition.ports import open_line
    from eitskin.reference.normaliser import rows_of
    from eitskin_tools.guided import Terminal, frames_of
    from eitskin_tools.teach.page import GuidePage

    places = grid_places(skin.outline.size_mm, skin.outline.kind, presses)
    talk = Terminal()
    with ExitStack() as stack:
        stack.callback(talk.end)
        line = open_line(port, baud)
        stack.callback(line.close)
        device = Device(line)
        table = rows_of(device.hello)
        recorder = PressRecorder(path, places, facts_of(skin, table))
        shown: Any = None
        if page is not None:
            shown = stack.enter_context(GuidePage(page, skin.outline.size_mm, skin.outline.kind, places))
            talk.say(f"the next place is shown at {shown.address}")

        def show(place: Place | None) -> None:
            if shown is not None:
                shown.show(place, recorder.left)

        device.start()
        PressGuide(recorder, frames_of(device, table), talk, show, count=frames).run()
        device.stop()


def presses_of_recording(recording: Path, places: Path, skin: Skin, frames: int, out: Path) -> None:
    """Write the presses of a recording to a file.

    Args:
        recording: Frames of the sheet, pressed at one place after another, and untouched in between.
        places: Text file of the places, in order.
        skin: Its sheet was pressed.
        frames: That a reading is the mean of.
        out: The file to write.

    Raises:
        SkinError: The recording, or the list, cannot be used; or other than one press was felt for each place.
        OSError: A file cannot be read or written.
    """
    from eitskin.reference.normaliser import rows_of
    from eitskin_tools.guided import GuideError
    from eitskin_tools.recording.convert import table_of
    from eitskin_tools.recording.script import Script

    script = Script(recording)
    found = table_of(script)
    fit = found.columns["withheld"] == ""
    wanted = places_of(places)
    recorder = PressRecorder(None, wanted, facts_of(skin, rows_of(script.hello)))
    guide = PressGuide(recorder, iter(found.voltages_V[fit]), Silent(), count=frames)
    try:
        guide.run()
        more = "more" if guide.feels_another() else ""
    except GuideError:
        more = ""
    if recorder.left or more:
        raise GuideError(
            f"{recording}: felt {more or len(recorder.presses)} presses{' than places' if more else ''}, expected the "
            f"{len(wanted)} of {places}, each held for {frames} frames and let go before the next"
        )
    recorder.save(out)


def facts_of(skin: Skin, table: RowTable) -> dict[str, Any]:
    """Return what a file of presses states of its sheet and its rows."""
    facts: dict[str, Any] = {"size_mm": np.array(skin.outline.size_mm), "outline": np.array(skin.outline.kind)}
    return facts if table.electrodes is None else {**facts, "table": table.electrodes}
