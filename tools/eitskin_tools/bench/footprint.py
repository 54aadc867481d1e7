"""``eitskin bench footprint``: time, memory and disk that the runtime takes before the first frame, beside torch's.

Each row starts fresh interpreters that import something, load the model where they can, and report their own clock and
memory. The runtime's row imports and loads what ``eitskin run`` does, which is one head; "runtime, float32" is
``eitskin run --solver vd2t``. Modules are read as bytecode, as installers make it; a first interpreter, which is not
counted, makes the bytecode here. ``load_ms`` is a median, ``cpu_ms`` the least of all repeats, which says more on a
busy machine. The installed size counts the files of a distribution and, for the runtime, of the dependencies that its
metadata names, each once.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_tools.bench.harness import report
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError

_PROBE: Final = """
import json, time
start, cpu = time.perf_counter(), time.process_time()
{body}
loaded, cpu = time.perf_counter() - start, time.process_time() - cpu
fields = dict(line.split(":", 1) for line in open("/proc/self/status").read().splitlines())
kb = lambda name: int(fields[name].split()[0])
print(json.dumps({{"load_ms": loaded * 1e3, "cpu_ms": cpu * 1e3, "rss_mb": kb("VmRSS") / 1024,
                  "peak_mb": kb("VmHWM") / 1024, "threads": int(fields["Threads"])}}))
"""

_RUNTIME: Final = """
import gc
gc.disable()
from eitskin.diagnostics import realtime
from eitskin.model.bundle import load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_proto.wire.messages import Hello
import eitskin.messaging.control, eitskin.messaging.publish, eitskin.skin
bundle = load_bundle({path!r}, lazily=True)
hello = Hello(firmware_version=(1, 0, 0), hardware_id=1, serial_number="", configuration_digest=0, generation=0,
              configuration_name="paper", rate_mHz=200_000, rows=104, sample_bytes=3, volts_per_count=1e-9)
pipeline = Pipeline(bundle, hello, solver={solver!r})
geometry = GeometryGraph(bundle)
pipeline.start_with(geometry.geometry(None, None, 0))
geometry.close_sessions()
realtime.settle()
"""

_TORCH: Final = """
import torch
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import Recipe
from eitskin.model.bundle import load_bundle
bundle = load_bundle({path!r})
model = VD2T(Recipe.from_dict(bundle.manifest["recipe"]).architecture, bundle.skin).eval()
torch.set_num_threads(1)
with torch.inference_mode():
    cloud = torch.zeros(1, 3, *bundle.skin.grid.shape)
    model(torch.zeros(1, 104), cloud, None, torch.zeros(1, 104) if bundle.uses_prediction else None)
"""

ROWS: Final = {
    "python": "pass",
    "numpy": "import numpy",
    "subscriber": "import eitskin; eitskin.subscribe",
    "runtime": _RUNTIME,
    "runtime, float32": _RUNTIME,
    "torch": _TORCH,
}
"""What each row's interpreter runs."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="fresh interpreters a row (default 5)")
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to load (default: the shipped one)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.repeats < 1:
        raise UsageError(f"--repeats is {arguments.repeats}; expected at least 1")
    rows, missing = [], {}
    with tempfile.TemporaryDirectory(prefix="eitskin-bytecode-") as bytecode:
        for name, body in ROWS.items():
            try:
                rows.append({"what": name, **_probe(name, body, arguments.bundle, arguments.repeats, bytecode)})
            except SkinError as error:
                missing[name] = str(error)
    for row in rows:
        row["installed_mb"] = _installed_mb(row["what"])
    summary: dict[str, Any] = {"missing": missing}
    by_name = {row["what"]: row for row in rows}
    if "runtime" in by_name and "torch" in by_name:
        ours, theirs = by_name["runtime"], by_name["torch"]
        summary |= {
            f"torch_over_runtime_{key}": round(theirs[key] / ours[key], 1)
            for key in ("load_ms", "cpu_ms", "rss_mb", "installed_mb")
            if ours[key] and theirs[key]
        }
    return report(arguments, rows, summary)


def _probe(name: str, body: str, bundle: Path | None, repeats: int, bytecode: str) -> dict[str, Any]:
    """Return the median load time, the least CPU time and the largest memory of some fresh interpreters."""
    where = None if bundle is None else str(bundle)
    code = _PROBE.format(body=body.format(path=where, solver="vd2t" if name == "runtime, float32" else None))
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": bytecode}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    found = []
    for _ in range(repeats + 1):
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment
        )
        if done.returncode:
            raise SkinError((done.stderr.strip().splitlines() or ["it printed nothing"])[-1])
        found.append(json.loads(done.stdout))
    found = found[1:]  # the first one made the bytecode and filled the page cache
    times = sorted(item["load_ms"] for item in found)
    return {
        "load_ms": round(times[len(times) // 2], 1),
        "cpu_ms": round(min(item["cpu_ms"] for item in found), 1),
        "rss_mb": round(max(item["rss_mb"] for item in found), 1),
        "peak_mb": round(max(item["peak_mb"] for item in found), 1),
        "threads": max(item["threads"] for item in found),
    }


def _installed_mb(row: str) -> float | None:
    roots = {"numpy": ["numpy"], "runtime": ["eitskin"], "torch": ["torch", "numpy"]}.get(row)
    if roots is None:
        return None
    names: set[str] = set()
    for root in roots:
        _collect(root, names)
    try:
        return round(sum(_size_mb(name) for name in sorted(names)), 1)
    except metadata.PackageNotFoundError:
        return None


def _collect(name: str, names: set[str]) -> None:
    """Add a distribution and what it needs without extras."""
    from re import match

    if name in names:
        return
    try:
        needs = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return
    names.add(name)
    for need in needs:
        if "extra ==" in need or ("platform_system" in need and "Linux" not in need):
            continue
        found = match(r"[A-Za-z0-9_.-]+", need)
        if found:
            _collect(found.group().lower().replace("_", "-"), names)


def _size_mb(name: str) -> float:
    if name == "eitskin":  # also where it is installed as editable
        folder = Path(__file__).parents[3]
        packages = [folder / part for part in ("runtime/eitskin", "firmware_proto/eitskin_proto")]
        if all(package.is_dir() for package in packages):
            found = [path for package in packages for path in package.rglob("*") if path.is_file()]
            return sum(path.stat().st_size for path in found if "__pycache__" not in path.parts) / 1e6
    located = [Path(str(file.locate())) for file in metadata.distribution(name).files or []]
    return sum(path.stat().st_size for path in located if path.is_file()) / 1e6
