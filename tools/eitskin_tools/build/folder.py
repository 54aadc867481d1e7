"""The folder of an unfinished bundle: its recipe and its finished parts.

::

    FILE.eitskin.build/
      build.json     the recipe as it was asked for, the hours, and the recipe as it was scaled to them
      data/NAME/     data sets          runs/N/     stages of training
      exported.json  what the export said of exported.eitskin
      small/         the same of the smaller network, where there is one; gentle/ of that for faint touches
      card/PART.json the card's parts, each with the id of the bundle that it is of

Each file is written whole. So a step that was stopped continues where it was.
"""

import json
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.files.plain import stated
from eitskin_proto.files.reading import FileError, read_json
from eitskin_proto.files.writing import is_empty, write_bytes
from eitskin_tools.build.recipe import BuildRecipe, Data, TrainingStage

LARGEST_FILE: Final = 16 << 20


class OtherBuildError(SkinError):
    """The folder holds something else."""


def begun(folder: Path, recipe: BuildRecipe, hours: float | None) -> dict[str, Any] | None:
    """Return what ``build.json`` says of a bundle that was begun here; None where nothing was.

    Args:
        folder: Of the half-made bundle.
        recipe: What is asked for.
        hours: For which time; None for the recipe's own size.

    Raises:
        OtherBuildError: It is another bundle, another time, or no such folder at all.
    """
    path = folder / "build.json"
    if not path.exists():
        if folder.exists() and (not folder.is_dir() or not is_empty(folder)):
            raise OtherBuildError(f"{folder} exists and is not the folder of a build; name another with --work")
        return None
    found = stored(path)
    if found is None or "recipe" not in found:
        raise OtherBuildError(f"{path} is damaged; remove {folder}, or name another with --work")
    hint = f"use the same options, name another folder with --work, or remove {folder}"
    if found.get("asked") != recipe.digest:
        name = found["recipe"].get("name") if isinstance(found["recipe"], dict) else None
        raise OtherBuildError(
            f"{folder} is the folder of a build of another recipe or skin: found {stated(name)} "
            f"{stated(found.get('asked'))}, expected {recipe.name} {recipe.digest}; {hint}"
        )
    if found.get("hours") != hours:
        raise OtherBuildError(f"{folder} was begun with --hours {stated(found.get('hours'))}, not {hours}; {hint}")
    return found


def begin(folder: Path, recipe: BuildRecipe, scaled: BuildRecipe, hours: float | None) -> None:
    """Write ``build.json``: from now on the folder is this bundle's."""
    folder.mkdir(parents=True, exist_ok=True)
    keep(folder / "build.json", {"asked": recipe.digest, "hours": hours, "recipe": scaled.as_dict()})


def scaled_as_before(recipe: BuildRecipe, found: dict[str, Any]) -> BuildRecipe:
    """Return a recipe with the sizes that were chosen when its bundle was begun.

    Raises:
        OtherBuildError: ``build.json`` does not hold them.
    """
    from dataclasses import replace

    try:
        before = found["recipe"]
        data = {name: Data(**before["data"][name]) for name in recipe.data}
        stages = tuple(TrainingStage(**{**one, "data": tuple(one["data"])}) for one in before["training"])
    except (KeyError, TypeError) as error:
        raise OtherBuildError(f"build.json is damaged ({error}); start in another folder with --work") from error
    return replace(recipe, data=data, training=stages)


def keep(path: Path, content: dict[str, Any]) -> None:
    """Write an object whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())


def stored(path: Path) -> dict[str, Any] | None:
    """Return an object that was kept; None where there is none, or none that can be read."""
    try:
        found = read_json(path, LARGEST_FILE)
    except (FileError, OSError):
        return None
    return found if isinstance(found, dict) else None
