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
    """Write a table as Parquet, a row a frame: clouds and reference stand in the file's own metadata, as NPY in hex.

    Raises:
        OSError: It cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {name: pa.array(values) for name, values in found.columns.items()}
    columns["voltages_V"] = _lists(pa, found.voltages_V)
    if found.maps is not None:
        columns["map"] = _lists(pa, found.maps.reshape(len(found.maps), -1))
    told = {name: script.told(name) for name in ("serial", "configuration", "bundle", "skin", "protocol_id", "grid_id")}
    arrays: dict[str, npt.NDArray[Any]] = {
        "reference_V": found.reference_V,
        "cloud_mm": found.clouds_mm,
        "predicted_V": found.predicted_V,
        "predicted_flat_V": found.predicted_flat_V,
    }
    shape = "" if found.maps is None else " ".join(map(str, found.maps.shape[1:]))
    metadata = {**told, "map_shape": shape, **{name: _hex(values) for name, values in arrays.items()}}
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
