"""What a recording came to, as a file and as a picture."""

from pathlib import Path

import numpy as np

from eitskin_proto.files.arrays import save_arrays
from eitskin_proto.files.writing import replacing
from eitskin_tools.pictures import save
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.reinfer.session import Maps, Reinferred


def write(path: Path, found: Reinferred) -> None:
    """Write ``seq``, ``touched``, ``solver``, ``wall_ns``, ``map``, and ``recorded_map`` beside another solver.

    Of a solver that asks physics also ``p_value``, NaN where nothing touches, and ``flagged``.

    Raises:
        RecordingError: No maps were kept.
        OSError: The file cannot be written.
    """
    maps = _kept(found)
    arrays = {
        "seq": np.array(maps.sequence, dtype=np.int64),
        "touched": np.array(maps.touched, dtype=np.bool_),
        "solver": np.array(maps.solver),
        "wall_ns": np.array(maps.log_ns, dtype=np.int64),
        "map": np.array(maps.maps, dtype=np.float32),
    }
    if found.others is not None:
        arrays["recorded_map"] = np.array(found.others.maps, dtype=np.float32)
    if found.verdicts is not None:
        arrays["p_value"] = np.array([np.nan if one is None else one.p_value for one in maps.judged])
        arrays["flagged"] = np.array([one is not None and one.flagged for one in maps.judged], dtype=np.bool_)
    with replacing(path) as stream:
        save_arrays(stream, arrays, compressed=True)


def draw(path: Path, found: Reinferred, most: int) -> None:
    """Draw the frames with the strongest touches, spread over the recording; beside another solver both maps.

    Args:
        path: Of the picture.
        found: With maps.
        most: How many frames.

    Raises:
        RecordingError: No maps were kept, or nothing was touched.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    maps = _kept(found)
    touched = [index for index, values in enumerate(maps.maps) if values.any()]
    if not touched:
        raise RecordingError("nothing was touched in this part of the recording: there is nothing to draw")
    parts = [part for part in np.array_split(touched, most) if len(part)]
    chosen = [max(part, key=lambda index: float(maps.maps[index].sum())) for part in parts]
    rows = [("maps", maps)] if found.others is None else [("recorded", found.others), ("computed now", maps)]
    figure = Figure(figsize=(2.4 * len(chosen), 2.0 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), len(chosen), squeeze=False)
    for axes_of_row, (title, kept) in zip(grid, rows, strict=True):
        for axes, index in zip(axes_of_row, chosen, strict=True):
            axes.imshow(kept.maps[index], origin="lower", vmin=0.0, vmax=1.0, cmap="viridis")
            axes.set_title(f"{title}, frame {kept.sequence[index]}", fontsize=7)
            axes.set_axis_off()
    save(figure, path, dpi=120)


def _kept(found: Reinferred) -> Maps:
    if found.maps is None or not found.maps.maps:
        raise RecordingError("no map came out of this part of the recording")
    return found.maps
