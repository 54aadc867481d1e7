"""Kinds that are folders: data sets and training runs."""

import json
import random
import shutil
from pathlib import Path

from . import mutations, samples

_DATA: list[Path] = []
_RUN: list[Path] = []


def data_set(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
    """Put a data set into a folder, damaged unless there is no generator, and return its path and what was done."""
    from eitskin_proto.files.digest import sha256_of

    out = folder / "data"
    shutil.copytree(_DATA[0], out)
    if rng is None:
        return out, "whole"
    index = json.loads((out / "index.json").read_text())
    how, name = rng.randrange(6), rng.choice(["touches.npz", "deformation-0000.npz"])
    if how < 2:
        (out / "index.json").write_text(mutations.text_of(mutations.changed(index, rng)))
        return out, "index"
    if how == 2:
        (out / "index.json").write_bytes(mutations.bent((out / "index.json").read_bytes(), rng))
        return out, "index, bytes"
    target = out / (name if how < 5 or rng.random() < 0.5 else "index.json")
    if how == 5:
        target.unlink()
        return out, f"{target.name} is no file: {mutations.special(target, rng)}"
    parts = samples.members_of(target.read_bytes())
    if how == 3:
        parts[rng.choice(list(parts))] = mutations.array(rng)
    data = mutations.zipped(parts) if how == 3 else mutations.archive(parts, rng)
    target.write_bytes(data)
    for entry in (index["touches"], *index["deformations"]):
        if entry["file"] == name:
            entry["sha256"] = sha256_of(data)
    (out / "index.json").write_text(json.dumps(index))
    return out, f"{name}, sealed again"


def run(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
    """Put the folder of a training run into a folder, as a data set is."""
    import torch

    out = folder / "run"
    shutil.copytree(_RUN[0], out)
    if rng is None:
        return out, "whole"
    target = out / rng.choice(("best.pt", "history.json"))
    how = rng.randrange(4)
    if how == 0:
        target.unlink()
        return out, f"{target.name} is no file: {mutations.special(target, rng)}"
    if target.suffix == ".json":
        target.write_text(mutations.text_of(mutations.changed(json.loads(target.read_text()), rng)))
        return out, "history"
    if how == 1:
        target.write_bytes(mutations.bent(target.read_bytes(), rng))
        return out, "best.pt, bytes"
    content = torch.load(target, weights_only=True)
    weights = content.pop("weights")
    changed = mutations.changed(content, rng)
    if isinstance(changed, dict):
        if how == 2 and weights:
            name = rng.choice(list(weights))
            weights[name] = rng.choice((torch.zeros(3), "text", None, torch.zeros(0), 7))
        changed["weights"] = weights if rng.random() < 0.95 else rng.choice(mutations.HOSTILE)
    torch.save(changed, target)
    return out, "best.pt, values"


def make_run(folder: Path) -> None:
    """Make the run that is damaged, in a folder that stays."""
    import torch

    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.skin import PAPER
    from eitskin_training.network.model import VD2T
    from eitskin_training.recipes import recipe

    torch.set_num_threads(1)
    out = folder / "run"
    out.mkdir()
    chosen = recipe("tiny")
    epochs = [
        {"number": 1, "training_loss": 0.5, "validation_loss": 0.4, "validation_cc": 0.9, "seconds": 1.0},
        {"number": 2, "training_loss": 0.4, "validation_loss": 0.3, "validation_cc": 0.95, "seconds": 1.0},
    ]
    content = {
        "format": 1, "protocol_id": PROTOCOL_ID, "grid_id": PAPER.grid_id, "recipe": chosen.as_dict(), "seed": 0,
        "data_digest": "0" * 16, "data": ["data"], "started_from": None, "history": epochs,
        "weights": VD2T(chosen.architecture, PAPER).state_dict(),
    }  # fmt: skip
    torch.save(content, out / "best.pt")
    (out / "history.json").write_text(json.dumps(epochs))
    _RUN.append(out)


def make_data_set(folder: Path) -> None:
    """Make the data set that is damaged, in a folder that stays."""
    samples.data_set(folder / "data")
    _DATA.append(folder / "data")
