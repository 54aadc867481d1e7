"""Several data sets as one: more touches and deformations than one run of ``eitskin dataset`` made.

Each set keeps its own splits; deformations and touch sets are numbered on. A sample that one set holds out and another
trains on tests nothing: two sets of one seed and different sizes share deformations, and on the unit grid touch sets
recur in any two. Such samples are left out of what is held out. A flat sheet and one that nothing touches may be seen.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.cloud import network_input
from eitskin_proto.skin.touch_kind import together
from eitskin_sim.arrays import Index
from eitskin_sim.dataset.reader import load as load_set
from eitskin_sim.scene.parts import Bend
from eitskin_sim.surface.predict import predicted_log
from eitskin_training.samples.batches import TrainingData


def load(directory: str) -> TrainingData:
    """Return a data set that ``eitskin dataset`` wrote.

    Raises:
        MismatchError: It was made for another protocol or grid.
        OSError: There is none.
    """
    found = load_set(directory)
    labels = found.units.astype(np.uint8) if found.labels_kind == "units" else found.label_table_u8()
    held_out = {
        "A": found.rows(deformations="kept", touches="validation").astype(np.intp),
        "B": found.rows(deformations="other", touches="validation").astype(np.intp),
    }
    return TrainingData(
        voltages=found.voltages_V,
        deformation=found.deformation.astype(np.intp),
        touch_set=found.touch_set.astype(np.intp),
        reference=found.reference_V,
        untouched=found.untouched_V,
        clouds=np.stack([network_input(cloud, found.skin.grid) for cloud in found.clouds]),
        log_predicted=predicted_log(found.clouds, found.skin),
        labels_kind=found.labels_kind,
        labels=labels,
        train=found.rows(deformations="train", touches="train").astype(np.intp),
        validation=found.rows(deformations="train", touches="validation").astype(np.intp),
        held_out={family: rows for family, rows in held_out.items() if len(rows)},
        digest=found.digest,
        seed=found.seed,
        skin=found.skin,
        touch_kind=found.touch_kind,
        drift=found.drift,
        bends=found.bends,
    )


ROUNDING: Final = 1e-9
"""Part by which references of one sheet may differ: those of two machines, or of one and two threads, do by 1e-14."""


def load_all(directories: Sequence[str]) -> TrainingData:
    """Return the data sets of some folders as one.

    Raises:
        MismatchError: One was made for another protocol, or they do not go together.
        OSError: There is none in a folder.
    """
    return join([load(one) for one in directories])


def join(sets: Sequence[TrainingData]) -> TrainingData:
    """Return data sets as one; its digest names all of theirs, in order.

    Args:
        sets: At least one, with the same reference and kind of labels.

    Raises:
        MismatchError: They do not go together, or one comes twice: its samples would count double.
    """
    first, hint = sets[0], "train on data sets of one version and kind"
    digests = [one.digest for one in sets]
    if len(sets) == 1:
        return first
    if twice := {digest for digest in digests if digests.count(digest) > 1}:
        raise MismatchError("data sets: digest", found=f"{', '.join(twice)} twice", expected="each once", hint=hint)
    for one in sets[1:]:
        for name, found, expected in (
            ("labels_kind", one.labels_kind, first.labels_kind),
            ("protocol_id", one.protocol_id, first.protocol_id),
            ("skin_digest", one.skin.digest, first.skin.digest),
        ):
            if found != expected:
                raise MismatchError(f"data set {one.digest}: {name}", found=found, expected=expected, hint=hint)
        off = float(np.abs(one.reference / first.reference - 1.0).max())
        if not off <= ROUNDING:
            raise MismatchError(
                f"data set {one.digest}: reference", found=f"off by {off:.1e}", expected="the first set's", hint=hint
            )
    samples, bends, touches = (
        np.cumsum([0, *(len(getattr(one, name)) for one in sets[:-1])]) for name in ("voltages", "clouds", "labels")
    )
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) for one in sets])
        for name in ("voltages", "untouched", "clouds", "log_predicted", "labels")
    }
    numbered_on: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) + start for one, start in zip(sets, starts, strict=True)])
        for name, starts in (
            ("deformation", bends), ("touch_set", touches), ("train", samples), ("validation", samples),
        )
    }  # fmt: skip
    held_out = {
        family: np.concatenate(
            [one.held_out[family] + at for one, at in zip(sets, samples, strict=True) if family in one.held_out]
        )
        for family in dict.fromkeys(family for one in sets for family in one.held_out)
    }
    every = tuple(bend for one in sets for bend in one.bends or (None,) * len(one.clouds))
    deformation, touch_set = numbered_on["deformation"], numbered_on["touch_set"]
    learned = numbered_on["train"]
    seen = np.zeros(len(whole["labels"]), dtype=np.bool_)
    if first.labels_kind == "units":
        seen = _seen_touches(whole["labels"], touch_set[learned])
    numbered_on["validation"] = numbered_on["validation"][~seen[touch_set[numbered_on["validation"]]]]
    known = _seen_bends(every, deformation[learned])[deformation] | seen[touch_set]
    held_out = {family: apart for family, rows in held_out.items() if len(apart := rows[~known[rows]])}
    kinds: dict[str, Any] = {"touch_kind": together(one.touch_kind for one in sets), "drift": _drift(sets)}
    return replace(first, **whole, **numbered_on, **kinds, bends=every, held_out=held_out, digest="+".join(digests))


def _seen_bends(bends: Sequence[Bend | None], learned: Index) -> npt.NDArray[np.bool_]:
    """Return (D,) which deformations are among those of the numbers that are learned from; the flat one is not."""
    own = {bends[number] for number in np.unique(learned)} - {None, Bend()}
    return np.array([bend in own for bend in bends], dtype=np.bool_)


def _seen_touches(units: npt.NDArray[np.uint8], learned: Index) -> npt.NDArray[np.bool_]:
    """Return (T,) which touch sets are among those of the numbers that are learned from; the empty one is not."""
    packed = [bits.tobytes() for bits in np.packbits(units, axis=1)]
    own = {packed[number] for number in np.unique(learned)} - {bytes(len(packed[0]))}
    return np.array([bits in own for bits in packed], dtype=np.bool_)


def _drift(sets: Sequence[TrainingData]) -> npt.NDArray[np.float32] | None:
    """Return the drift of every sample; None where none has any."""
    if all(one.drift is None for one in sets):
        return None
    still = (np.ones(len(one.voltages), dtype=np.float32) if one.drift is None else one.drift for one in sets)
    return np.concatenate(list(still))
