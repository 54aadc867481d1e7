"""Numbers chosen to be slow to compute: in counts, references, clouds, bundles, with electrodes left out or not.

Each try sends frames through the runtime's pipeline and then looks at all that its solvers were given and what they
made of it. Nothing in there may be smaller than a processor computes at full speed, but 0.
"""

import io
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from eitskin.health.monitor import health_of
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin.skin import CloudChange
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.messages import Hello

from ..outcome import Effort, Outcome

HELLO = Hello(
    firmware_version=(1, 0, 0), hardware_id=1, serial_number="N", configuration_digest=1, generation=0,
    configuration_name="n", rate_mHz=200_000, rows=N_ROWS, sample_bytes=4, volts_per_count=1e-9,
)  # fmt: skip
FRAMES = 8
FULL = 2**31 - 1


def denormals(effort: Effort) -> Outcome:
    """Try to get a denormal to the gate, a network or the projection."""
    outcome = Outcome("numbers.denormals", figures={"frames_published": 0})
    bundle = load_bundle(default_path("units"))
    for number in range(effort.count(12, 150)):
        seed = (effort.seed, number)
        rng = np.random.default_rng(seed)
        found = _try(_hostile(bundle, rng), rng, outcome)
        outcome.note(found == "", f"seed {seed}: {found}")
    outcome.note(outcome.figures["frames_published"] > 0, "no frame was ever published: nothing was attacked")
    return outcome


def _hostile(bundle: Bundle, rng: np.random.Generator) -> Bundle:
    """Return a bundle with denormals in its projection and in what fills rows in; or as it is."""
    if rng.random() < 0.3:
        return bundle
    tiny = float(10.0 ** rng.uniform(-44, -38))
    matrix = bundle.tikhonov().copy()
    matrix[rng.random(len(matrix)) < 0.2] = tiny
    arrays = dict(bundle.consistency_arrays() or {})
    arrays["mean"] = np.full(N_ROWS, tiny)
    changed = {"tikhonov.npy": io.BytesIO(), "consistency.npz": io.BytesIO()}
    np.save(changed["tikhonov.npy"], matrix)
    np.savez(changed["consistency.npz"], **{name: np.asarray(value) for name, value in arrays.items()})
    files = {name: bundle.files[name] for name in bundle.files if name not in changed}
    return replace(bundle, files=files | {name: data.getvalue() for name, data in changed.items()})


def _denormal(what: str, *arrays: Any) -> str:
    for values in arrays:
        size = np.abs(values)
        if ((size > 0.0) & (size < np.finfo(np.float32).tiny)).any():
            return f"{what} holds {size[size > 0.0].min():g}"
    return ""


def _try(bundle: Bundle, rng: np.random.Generator, outcome: Outcome) -> str:
    volts_per_count = float(10.0 ** rng.uniform(-12, -6))
    shape = rng.uniform(0.01, 1.0, N_ROWS) * rng.choice([-1.0, 1.0], N_ROWS)
    usual = np.rint(shape * 10.0 ** rng.uniform(5, 9))  # counts
    voltages = usual * volts_per_count
    voltages[rng.random(N_ROWS) < 0.05] *= rng.choice([0.0, 1e-310, 1e-40, 1e-5])
    pipeline = Pipeline(
        bundle, replace(HELLO, volts_per_count=volts_per_count), health=health_of(bundle), skip_unchanged=False,
        solver=str(rng.choice(["vd2t", "vd2t-int8", "tikhonov"])),
    )  # fmt: skip
    clouds = CloudChange(pipeline)
    reference = Reference(voltages, np.abs(voltages) * 1e-4, 100, "N", 1, "n", "")
    pipeline.use_reference(reference)
    if rng.random() < 0.5:
        cloud = flat_cloud()
        cloud[2] = 10.0 ** rng.uniform(-320, -20) * rng.standard_normal(cloud[2].shape)
        clouds.use(cloud, voltages * 1.0 if rng.random() < 0.5 else None, None, reference)
    if rng.random() < 0.5:
        pipeline.exclude(tuple(sorted(int(one) for one in rng.choice(16, rng.integers(1, 4), replace=False))))
    for sequence in range(1, FRAMES + 1):
        counts = usual + rng.choice([0, 1, -1, 1000, 10**9], N_ROWS, p=[0.6, 0.15, 0.15, 0.08, 0.02])
        if rng.random() < 0.1:
            counts = usual
        payload = Frame(sequence, sequence * 5000, np.clip(counts, -FULL, FULL).astype(np.int32)).pack()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            passed = pipeline.accept(payload, 1) and pipeline.compute(True)
            pipeline.keep_for_health()
        outcome.figures["frames_published"] += passed
        for name in ("change", "bias", "log_predicted", "map"):
            found = _denormal(name, getattr(pipeline.buffers, name))
            if found:
                return found
    return ""
