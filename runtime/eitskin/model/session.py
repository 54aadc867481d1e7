"""The only access to ONNX Runtime: sessions of one thread, with checked inputs and outputs, and no telemetry.

ONNX Runtime gets one thread that is the caller's: its own pool escapes CPU pinning and costs 8 ms at p99 under load.

By default the library creates an id and a database for telemetry in the user's cache with the first session, and may
call home. An environment variable stops both if it is set before the library is loaded; so code that needs
``onnxruntime`` gets it from this module.
"""

import os
from collections.abc import Mapping
from typing import Any, Final

NO_TELEMETRY: Final = "ORT_DISABLE_TELEMETRY"

os.environ[NO_TELEMETRY] = "1"

import onnxruntime  # noqa: E402 -- behind the variable

from eitskin.errors import BundleError, MismatchError  # noqa: E402
from eitskin.model.bundle import EXPORT_HINT, Bundle  # noqa: E402
from eitskin.model.onnx_graph import check_graph  # noqa: E402
from eitskin_proto.files.plain import plain  # noqa: E402
from eitskin_proto.sensor.ids import PROTOCOL_ID  # noqa: E402

__all__ = [
    "NO_TELEMETRY",
    "check_signature",
    "checked_graph",
    "first_line",
    "onnxruntime",
    "open_session",
    "session_options",
]


def session_options() -> Any:
    """Return options of a session that multiplies 8-bit numbers exactly, and warns of nothing.

    Without the entry a processor that has AVX2 or AVX-512 and no VNNI adds products of 8 bits in pairs of 16 bits.
    These overflow: the narrow network of ``free`` lost 0.03 of CC. With the entry such a processor widens first.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.x64quantprecision", "1")
    return options


def checked_graph(bundle: Bundle, file: str) -> bytes:
    """Return a bundle's graph, which may be run.

    Raises:
        BundleError: It holds what no exported network has.
    """
    graph = bundle.files[file]
    try:
        check_graph(graph)
    except BundleError as error:
        raise BundleError(f"{bundle.path}: {file}: {error}; {EXPORT_HINT}") from error
    return graph


def open_session(bundle: Bundle, file: str, graph: bytes) -> Any:
    """Return a session of one thread, the caller's, without a pool of its own.

    Args:
        bundle: Where the graph is from.
        file: Its name there.
        graph: Of :func:`checked_graph`.

    Raises:
        BundleError: ONNX Runtime cannot load it.
        MismatchError: It was made for another protocol_id or grid_id.
    """
    options = session_options()
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.load_model_format", "ONNX")  # the kind that was checked, whatever it says
    try:
        session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no base of their own
        raise BundleError(f"{bundle.path}: {file} cannot be loaded ({first_line(error)}); {EXPORT_HINT}") from error
    if hasattr(session, "_model_bytes"):
        session._model_bytes = b""  # kept for a change of provider, which never comes: as many bytes as the weights
    metadata = session.get_modelmeta().custom_metadata_map
    for key, expected in (("protocol_id", PROTOCOL_ID), ("grid_id", bundle.skin.grid_id)):
        if metadata.get(key, expected) != expected:
            raise MismatchError(f"{file}: {key}", found=metadata[key], expected=expected, hint=EXPORT_HINT)
    return session


def check_signature(
    file: str, session: Any, inputs: Mapping[str, tuple[int, ...]], output: str, shape: tuple[int, ...]
) -> None:
    """Refuse a session with other inputs or another output.

    Args:
        file: Name of the graph, for the message.
        session: Of ONNX Runtime.
        inputs: Shape by name.
        output: Name of the only one.
        shape: Its shape.

    Raises:
        BundleError: They differ, or are not float32.
    """
    found = {value.name: tuple(value.shape) for value in session.get_inputs()}
    if found != inputs:
        raise BundleError(f"{file}: inputs found {found}, expected {inputs}; {EXPORT_HINT}")
    outputs = {value.name: tuple(value.shape) for value in session.get_outputs()}
    if outputs != {output: shape}:
        raise BundleError(f"{file}: outputs found {outputs}, expected {{{output!r}: {shape}}}; {EXPORT_HINT}")
    kinds = {value.type for value in (*session.get_inputs(), *session.get_outputs())}
    if kinds != {"tensor(float)"}:
        raise BundleError(f"{file}: types found {sorted(kinds)}, expected tensor(float) only; {EXPORT_HINT}")


def first_line(error: BaseException) -> str:
    """Return ONNX Runtime's error in a printable line."""
    return plain(str(error).strip().partition("\n")[0][:200])
