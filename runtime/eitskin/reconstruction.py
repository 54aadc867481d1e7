"""Maps of voltages that a program has in an array, without a device and without a stream."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.engine import default_solver, engines
from eitskin.model.gate import Gate
from eitskin.model.geometry import GeometryGraph
from eitskin.model.taught import field_of
from eitskin.reference.normaliser import Normaliser
from eitskin_proto.sensor.row_table import RowTable, row_map, table_of, usual_table


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """What :func:`reconstruct` returns, of n frames."""

    map: npt.NDArray[np.float32]
    """(n, rows, columns) from 0, untouched, to 1; all 0 in frames that are not touched."""
    touched: npt.NDArray[np.bool_]
    """(n,) whether the gate calls the sheet touched; all true for a bundle without a gate."""
    solver: str
    """Which solver made the maps."""


def reconstruct(
    voltages: npt.ArrayLike,
    reference: npt.ArrayLike,
    bundle: Bundle | str | Path | None = None,
    cloud: npt.ArrayLike | None = None,
    table: RowTable | str | npt.ArrayLike | None = None,
) -> Reconstruction:
    """Return the maps of frames, by the gate and the solver that ``eitskin run`` uses.

    Args:
        voltages: (n, rows) or (rows,) V, signed or amounts; each frame is judged by itself.
        reference: (rows,) V of the untouched sheet, by the same device.
        bundle: A bundle, its file, or a shipped one's name; None takes ``free``.
        cloud: (3, rows of the map, columns) mm, the shape of the sheet; None for the flat sheet. Networks use it.
        table: Rows of the voltages: a name such as ``adjacent-208`` or ``pyeit-208``, or (rows, 4) electrodes drive +,
            drive -, measure +, measure -; None for the usual table of this number of rows.

    Raises:
        ValueError: Voltages, reference or cloud have a wrong shape or are not finite, or the bundle's rows cannot be
            computed from these.
        BundleError: The bundle cannot be used.
        MismatchError: The reference has other levels than the sheet that was taught.
    """
    loaded = bundle if isinstance(bundle, Bundle) else load_bundle(bundle, lazily=True)
    volts, untouched = _checked(voltages, reference)
    source = usual_table(len(untouched)) if table is None else table_of(table)
    if source.rows != len(untouched):
        raise ValueError(f"voltages have {len(untouched)} rows, expected {source.rows}, those of {source.name}")
    try:
        mapped = row_map(source, loaded.table, signed=bool((untouched < 0.0).any()))  # else they are amounts
    except ValueError as error:
        raise ValueError(f"{loaded.path}: {error}; take a bundle of these rows, or name their table") from error
    normaliser, frame = Normaliser(1.0, loaded.rows, mapped), np.zeros(loaded.rows)
    if mapped is None:
        frame[:] = untouched
    else:
        mapped.apply(untouched, frame)
    normaliser.use_reference(frame)
    gates, field = loaded.gate_arrays(), field_of(loaded)
    if field is not None:
        field.use_reference(frame)
    gate = field or (None if gates is None else Gate(gates, loaded.rows))
    buffers = Buffers(loaded, None if gate is None else gate.change)
    if loaded.has_network or cloud is not None:
        buffers.use_geometry(GeometryGraph(loaded).geometry(cloud, None, 0 if cloud is None else 1))
    engine = engines(loaded, buffers, best=default_solver(loaded), alone=True, field=field)[0]
    maps = np.zeros((len(volts), *loaded.skin.grid.shape), dtype=np.float32)
    touched = np.ones(len(volts), dtype=np.bool_)
    for number, row in enumerate(volts):
        normaliser.load(row)
        if not normaliser.change_into(buffers.change[0]):
            why = "have no signal" if normaliser.silent else "are too far from the reference to be of one sheet"
            raise ValueError(f"voltages of frame {number} {why}; leave the frame out")
        if gate is not None:
            gate.reset()  # the frames of an array may be of any times
            touched[number] = gate.touched()
        if touched[number]:
            engine.infer()
            maps[number] = buffers.map.reshape(maps.shape[1:])
    return Reconstruction(maps, touched, engine.name)


def _checked(
    voltages: npt.ArrayLike, reference: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return (n, rows) and (rows,) V."""
    if np.iscomplexobj(voltages) or np.iscomplexobj(reference):
        raise ValueError(
            "voltages or reference are complex, expected real numbers in V: project each row on its phase in the "
            "reference, or hand the scans to eitskin.Feed"
        )
    try:
        volts, untouched = (np.asarray(values, dtype=np.float64) for values in (voltages, reference))
    except (TypeError, ValueError) as error:
        raise ValueError(f"voltages and reference must be real numbers in V: {error}") from error
    if untouched.ndim != 1 or volts.ndim not in (1, 2) or volts.shape[-1] != len(untouched):
        raise ValueError(
            f"voltages have shape {volts.shape} and the reference {untouched.shape}; expected (n, rows) or (rows,), "
            "and (rows,)"
        )
    for name, values in (("voltages", volts), ("the reference", untouched)):
        if not np.isfinite(values).all():
            where = np.argwhere(~np.isfinite(values))[0].tolist()
            raise ValueError(f"{name} at {where} is not finite, expected V; leave such frames out")
    return np.atleast_2d(volts), untouched
