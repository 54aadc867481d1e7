"""Tables as NPZ and as Parquet."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import save_arrays
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_tools.recording.convert.table import Table
from eitskin_tools.recording.script import Script


def write_npz(path: Path, found: Table, script: Script) -> None:
    """Write a table as NPZ: arrays that ``eitskin evaluate --measured`` reads, and more.

    Raises:
        OSError: It cannot be written.
    """
    arrays: dict[str, npt.NDArray[Any]] = {
        **{name: values for name, values in found.columns.items() if name != "cloud_index"},
        "voltages_V": found.voltages_V,
        "reference_V": found.reference_V,
        "predicted_V": found.predicted_V,
        "predicted_flat_V": found.predicted_flat_V,
        "protocol_id": np.array(script.told("protocol_id") or PROTOCOL_ID),
        "grid_id": np.array(script.told("grid_id")),
        "bundle": np.array(script.told("bundle")),
        "serial": np.array(script.told("serial")),
    }
    if len(found.clouds_mm):
        arrays |= {"cloud_mm": found.clouds_mm, "cloud_index": found.columns["cloud_index"]}
    if found.maps is not None:
        arrays["map"] = found.maps
    with replacing(path) as stream:
        save_arrays(stream, arrays, compressed=True)


def write_parquet(path: Path, found: Table, script: Script) -> None:
    """Write a table as Parquet, a row a frame.

    A cloud stands in the row of its first frame, with its predictions; other rows have its number and no cloud. The
    reference stands in the file's own metadata, as NPY in hex: readers take some megabytes there, and no more.

    Raises:
        OSError: It cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {name: pa.array(values) for name, values in found.columns.items()}
    columns["voltages_V"] = _lists(pa, found.voltages_V)
    if found.maps is not None:
        columns["map"] = _lists(pa, found.maps.reshape(len(found.maps), -1))
    clouds, first = np.unique(found.columns["cloud_index"], return_index=True)
    row_of = {row: cloud for row, cloud in zip(first.tolist(), clouds.tolist(), strict=True) if cloud >= 0}
    for name, values, kind in (
        ("cloud_mm", found.clouds_mm, pa.float32()),
        ("predicted_V", found.predicted_V, pa.float64()),
        ("predicted_flat_V", found.predicted_flat_V, pa.float64()),
    ):
        rows = [values[row_of[row]].ravel() if row in row_of else None for row in range(len(found.voltages_V))]
        columns[name] = pa.array(rows, pa.list_(kind))
    told = {name: script.told(name) for name in ("serial", "configuration", "bundle", "skin", "protocol_id", "grid_id")}
    shapes = {
        "map_shape": () if found.maps is None else found.maps.shape[1:],
        "cloud_shape": found.clouds_mm.shape[1:] if len(found.clouds_mm) else (),
    }
    metadata = {**told, **{name: " ".join(map(str, shape)) for name, shape in shapes.items()}}
    metadata["reference_V"] = _hex(found.reference_V)
    table = pa.table(columns).replace_schema_metadata(metadata)
    with replacing(path) as stream:
        pq.write_table(table, stream, compression="zstd")


def _lists(pa: Any, values: npt.NDArray[Any]) -> Any:
    """Return the rows of an array as lists of one length."""
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def _hex(values: npt.NDArray[Any]) -> str:
    from io import BytesIO

    stream = BytesIO()
    np.save(stream, values)
    return stream.getvalue().hex()
