"""One bundle's recipe: a TOML file that says its skin, data, training and card, all of it.

::

    format = "eitskin-recipe"      version = 1     name = "press"
    skin = "hydrogel"              a shipped skin, or a file beside this one
    network = "free"               what is trained: a recipe of 'eitskin train'
    small = "press-small"          an additional, smaller network: a shipped recipe, or a file beside this one
    gentle = "gentle"              an additional network for faint touches, likewise

    [data.presses]                 a data set, by any name: the options of 'eitskin dataset'
    set = "free"                   touches, devices, skin, seed, deformations, per_deformation, touch_sets, kept, near

    [[training]]                   one stage of training, on all data sets or on those that ``data`` names; the next one
    epochs = 10                    begins with its best weights. learning_rate, schedule, seed, noise; of the first
    start_from = "free"            stage start_from: a shipped bundle, or a file beside this one
    network = "free"               of a stage before the last: a larger network, which the next one begins narrowed from

    [gate]                         untouched sheets that are solved for it (0: the data's own)
    [card]                         how much is tried for the card: deformations, each, draws
    [missing_electrodes]           teaches it in the end to go on without electrodes: fitting_steps, steps, seed
"""

from dataclasses import MISSING as NO_DEFAULT
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final, TypeVar, get_args, get_origin, get_type_hints

from eitskin.model.manifest import EXTRA_NETWORKS, GENTLE, SMALL
from eitskin_proto.fields import Fields
from eitskin_proto.files.digest import id_of_values
from eitskin_proto.files.plain import plain, quoted
from eitskin_proto.files.reading import LARGEST_TOML, is_name, parse_toml, read_text
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import FORMAT as SKIN_FORMAT
from eitskin_proto.skin.toml import to_toml
from eitskin_tools.command_line import files, options

FORMAT: Final = "eitskin-recipe"
VERSION: Final = 1

MISSING: Final = "missing_electrodes"
"""The table of the last lesson."""

MIN_NUMBERS: Final = {"seed": 0, "kept": 0, "untouched": 0, "fitting_steps": 0}
"""Of whole numbers; all others are at least 1."""

LARGEST_NUMBER: Final = 10**9
LONGEST_NAME: Final = 200

Record = TypeVar("Record")

SKIN: Final = "skin"
"""What follows the skin's file: touches of data, noise of training."""


@dataclass(frozen=True, slots=True)
class Data:
    """A data set; what is None is as ``eitskin dataset`` has it."""

    set: str = "free"
    touches: str = "hard"
    devices: str = "ideal"
    seed: int = 0
    deformations: int = 400
    per_deformation: int = 1000
    touch_sets: int | None = None
    kept: int | None = None
    near: float | None = None
    skin: str | None = None
    """Another one than the recipe's: its name or file."""


@dataclass(frozen=True, slots=True)
class TrainingStage:
    """One stage of training; what is None is as the network's own recipe has it."""

    epochs: int
    data: tuple[str, ...] = ()
    """Names of data sets; none are all of them."""
    learning_rate: float | None = None
    schedule: str | None = None
    seed: int = 0
    start_from: str | None = None
    noise: str | None = None
    """``skin``: from level to level as the skin's front end says."""
    network: str | None = None
    """What is trained in this stage; None is the bundle's own, as in the last stage."""


@dataclass(frozen=True, slots=True)
class GateWork:
    """What the gate is fitted with."""

    untouched: int = 900
    """Untouched sheets that are solved for it; 0 for those of the data alone."""


@dataclass(frozen=True, slots=True)
class CardWork:
    """How much is tried for the card."""

    deformations: int = 8
    each: int = 3
    draws: int = 2
    """Devices of each mismatch."""


@dataclass(frozen=True, slots=True)
class MissingElectrodesWork:
    """How long a network learns to go on without electrodes."""

    fitting_steps: int = 2000
    """Of the filling alone."""
    steps: int = 3000
    """Of filling and network together."""
    seed: int = 0


@dataclass(frozen=True, slots=True)
class BuildRecipe:
    """Everything that makes a bundle."""

    name: str
    skin: Skin
    network: str
    data: dict[str, Data]
    training: tuple[TrainingStage, ...]
    gate: GateWork = GateWork()
    card: CardWork = CardWork()
    beside: Path = Path()
    """The folder that its files are named from."""
    small: str = ""
    """Recipe of the smaller network that goes into the bundle; empty for none."""
    gentle: str = ""
    """Recipe of the network for faint touches that goes into the bundle; empty for none."""
    missing_electrodes: MissingElectrodesWork | None = None
    """The last lesson, for a network that is to learn to go on without electrodes; None for none."""
    networks: "dict[str, BuildRecipe]" = field(default_factory=dict)
    """Recipes of additional networks, ``small`` or ``gentle``, that are in no file."""

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values, the skin as its TOML."""
        found = {**asdict(self), "skin": to_toml(self.skin)}
        del found["beside"]
        found["networks"] = {name: one.as_dict() for name, one in self.networks.items()}
        for name in (*EXTRA_NETWORKS, "missing_electrodes", "networks"):
            if not found[name]:
                del found[name]
        for stage in found["training"]:
            if stage["network"] is None:
                del stage["network"]
        return found

    @property
    def digest(self) -> str:
        """16 hex digits that stand for all of it."""
        return id_of_values(self.as_dict())

    def skin_of(self, data: Data) -> Skin:
        """Return the skin of one of its data sets.

        Raises:
            MissingFileError: There is no such file.
            ValueError: It is no skin's description.
        """
        return self.skin if data.skin is None else _skin(data.skin, self.beside)

    def others(self) -> "dict[str, BuildRecipe]":
        """Return the recipes of the bundle's additional networks by name: ``small``, ``gentle``.

        Raises:
            MissingFileError: There is no such file.
            ValueError: One is not a recipe, has an additional network itself, or is for another skin or other labels.
        """
        named = {name: getattr(self, name) for name in EXTRA_NETWORKS if getattr(self, name)}
        found = {name: self._other(name, recipe) for name, recipe in named.items()}
        return found | self.networks

    def _other(self, name: str, recipe: str) -> "BuildRecipe":
        from eitskin_training.recipes import recipe as network_named

        own = self.beside / recipe
        found = load(str(own) if own.is_file() else recipe)
        if more := [one for one in EXTRA_NETWORKS if getattr(found, one)]:
            raise ValueError(f"{name} is {quoted(recipe)}, which has {more[0]} too; expected a recipe without it")
        for what, one, other in (
            ("skin", found.skin.digest, self.skin.digest),
            ("labels", network_named(found.network).labels, network_named(self.network).labels),
        ):
            if one != other:
                raise ValueError(f"{name} is {quoted(recipe)}: {what} found {one}, expected {other}")
        return found


def load(name: str) -> BuildRecipe:
    """Return the recipe of a file, the usual one for a skin's file, or a shipped one by its name.

    Raises:
        MissingFileError: There is no such file.
        ValueError: It is neither a recipe nor a skin's description; the text names file and key.
    """
    if is_name(name, files.SKIN.names()) and name not in files.RECIPE.names():
        return usual(options.read_skin(name))
    path = files.find(name, files.RECIPE)
    try:
        content = parse_toml(read_text(path, LARGEST_TOML))
        if content.get("format") == FORMAT:
            return parse(content, path.parent)
        if content.get("format") == SKIN_FORMAT:
            return usual(options.read_skin(str(path)))
        found = f"format is {quoted(content['format'])}" if "format" in content else "it has no format"
        raise ValueError(f"{found}, expected {SKIN_FORMAT!r}, a skin's description, or {FORMAT!r}, a bundle's recipe")
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path}: {text}") from error


def usual(skin: Skin) -> BuildRecipe:
    """Return what is built for a skin where nothing else is said: random devices, touched as the skin says."""
    data = Data(touches=SKIN, devices="random")
    return BuildRecipe(skin.name, skin, "free", {"touches": data}, (TrainingStage(epochs=20, noise=SKIN),))


def parse(content: dict[str, Any], beside: Path = Path()) -> BuildRecipe:
    """Return the recipe of a TOML file's content.

    Args:
        content: What the file says.
        beside: The folder that its files are named from.

    Raises:
        MissingFileError: A file that it names is not there.
        ValueError: A key is unknown, missing or of another kind; named.
    """
    from eitskin_training.recipes import recipe as network_named

    head = Fields(content, "")
    head.check_format(FORMAT, VERSION, "a bundle's recipe")
    texts = {key: head.text(key, longest=LONGEST_NAME) for key in ("name", "skin", "network")}
    networks = {key: head.text(key, "", longest=LONGEST_NAME) for key in EXTRA_NETWORKS}
    network = network_named(texts["network"])
    sets, stages = head.table("data"), head.entries("training", least=1, of="tables [[training]]")
    gate, card = head.table("gate", "[gate]"), head.table("card", "[card]")
    lesson = head.table(MISSING, f"[{MISSING}]")
    head.close()
    if not len(sets):
        raise ValueError("found no data set, expected tables such as [data.touches]")
    if bad := [name for name in sets if not name.replace("-", "").replace("_", "").isalnum()]:
        raise ValueError(f"a data set is called {quoted(bad[0])}, expected letters, digits, - and _")
    data = {name: _record(Data, sets.table(name, f"[data.{name}]")) for name in sets}
    training = tuple(_record(TrainingStage, stages.table(place, f"[[training]] {place + 1}")) for place in stages)
    for number, stage in enumerate(training, 1):
        if missing := [name for name in stage.data if name not in data]:
            raise ValueError(f"[[training]] {number} names data {quoted(missing[0])}, known are {', '.join(data)}")
        if stage.noise not in (None, SKIN):
            raise ValueError(f"noise in [[training]] {number} is {quoted(stage.noise)}, expected {SKIN!r} or none")
        if stage.network is not None and (
            number == len(training) or network_named(stage.network).labels != network.labels
        ):
            raise ValueError(
                f"network in [[training]] {number} is {quoted(stage.network)}, expected one of the same labels as "
                f"{network.name}, in a stage before the last"
            )
        if number > 1 and stage.start_from is not None:
            raise ValueError(
                f"[[training]] {number} has start_from, expected it in the first stage only: later stages continue "
                "from it"
            )
    for name, one in data.items():
        if (one.set == "free") != (network.labels == "area"):
            kind = "free" if network.labels == "area" else "units"
            raise ValueError(f"[data.{name}] set is {quoted(one.set)}, network {network.name} learns from {kind!r}")
    return BuildRecipe(
        plain(texts["name"]),
        _skin(texts["skin"], beside),
        texts["network"],
        data,
        training,
        _record(GateWork, gate),
        _record(CardWork, card),
        beside,
        missing_electrodes=_record(MissingElectrodesWork, lesson) if MISSING in content else None,
        small=networks[SMALL],
        gentle=networks[GENTLE],
    )


def _record(kind: type[Record], table: Fields) -> Record:
    """Return a table as its dataclass, whose annotations say which kind each key has."""
    values: dict[str, Any] = {}
    hints = get_type_hints(kind)
    for one in fields(kind):  # type: ignore[arg-type]  # a dataclass
        if one.name not in table:
            if one.default is NO_DEFAULT:
                raise table.wrong(one.name, "a value")
            continue
        hint = hints[one.name]
        if get_origin(hint) is tuple:
            values[one.name] = table.texts(one.name)
        elif hint is str or str in get_args(hint):
            values[one.name] = table.text(one.name)
        elif float in get_args(hint):
            values[one.name] = table.number(one.name, low=0.0, high=LARGEST_NUMBER)
        else:
            values[one.name] = table.whole(one.name, low=MIN_NUMBERS.get(one.name, 1), high=LARGEST_NUMBER)
    table.close()
    return kind(**values)


def _skin(name: str, beside: Path) -> Skin:
    own = beside / name
    return options.read_skin(str(own) if own.is_file() else name)
