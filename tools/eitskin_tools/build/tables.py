"""A table of a recipe as its dataclass, every key checked; what is wrong is named with its key."""

from typing import Any, Final

from eitskin_proto.files.plain import quoted
from eitskin_proto.skin.toml import unknown

KINDS: Final[dict[str, tuple[type, ...]]] = {
    "set": (str,), "touches": (str,), "devices": (str,), "skin": (str,), "schedule": (str,), "start_from": (str,),
    "noise": (str,), "network": (str,),
    "data": (list,), "near": (int, float), "learning_rate": (int, float),
}  # fmt: skip
"""Of the keys of tables; all others are whole numbers."""

LEAST: Final = {"seed": 0, "kept": 0, "untouched": 0, "steps": 1, "fitting_steps": 0}
"""Of whole numbers; all others are at least 1."""


def table(kind: type, content: Any, where: str) -> Any:
    """Return a table as its dataclass, every key checked.

    Args:
        kind: The dataclass.
        content: The table.
        where: What it is called, for messages.

    Raises:
        ValueError: It is none, or a key is unknown, missing or of another kind.
    """
    if not isinstance(content, dict):
        raise ValueError(f"{where} is {quoted(content)}, expected a table")
    unknown(content, list(kind.__dataclass_fields__), where)  # type: ignore[attr-defined]
    values: dict[str, Any] = {}
    for key, value in content.items():
        kinds = KINDS.get(key, (int,))
        fits = isinstance(value, kinds) and not isinstance(value, bool)
        if kinds == (list,):
            fits = fits and all(isinstance(item, str) for item in value)
        elif str not in kinds:
            fits = fits and LEAST.get(key, 1 if kinds == (int,) else 0) <= value <= 1e9
        if not fits:
            raise ValueError(f"{key} in {where} is {quoted(value)}, expected {_expected(key, kinds)}")
        values[key] = tuple(value) if kinds == (list,) else value
    try:
        return kind(**values)
    except TypeError as error:
        raise ValueError(f"{where} lacks {str(error).rsplit(':', 1)[-1].strip()}") from error


def _expected(key: str, kinds: tuple[type, ...]) -> str:
    if kinds == (list,):
        return "a list of names"
    if kinds == (str,):
        return "a text"
    return f"a whole number of at least {LEAST.get(key, 1)}" if kinds == (int,) else "a number of at least 0"
