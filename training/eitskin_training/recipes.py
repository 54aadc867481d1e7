"""Recipes: all parameters of a training run, as named values with their source.

``paper`` is section V.A of the paper. ``units`` and ``free`` are what a robot needs: several-parameter deformations,
all three noises, the sheet's mirror symmetries, missing rows; ``units`` keeps the paper's hard labels on the 126 units,
``free`` has area labels of touches anywhere. ``small`` is ``free`` with layers narrowed to a fifth of the weights,
``small-units`` is ``units`` of about half the width, a third of the weights; ``tiny`` is one in seconds, for tests
and CI.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

from eitskin_proto.skin.skin import Skin
from eitskin_training.network.architecture import STORED_OUTPUTS, Architecture
from eitskin_training.network.mirror import mirrors

Labels = Literal["units", "area"]
Schedule = Literal["constant", "onecycle"]
Noise = Literal["N1", "N2", "N3"]

MAX_SEED: Final = 1_000_000_000
"""Of a run: every epoch's draws follow from it and the epoch's number, within 64 bits."""

PAPER_BATCH: Final = 512
"""Samples a step (paper section V.A)."""

PAPER_EPOCHS: Final = 100
"""Passes through the data (paper section V.A)."""

PAPER_LEARNING_RATE: Final = 1e-4
"""Adam's step (paper section V.A). It is slow: CC 0.42 after 6 epochs."""

PAPER_SNR_DB: Final = 50.0
"""White noise added to the training data (paper section V.A)."""

RANKS: Final = (64, 26, 30, 30)
"""Of the layers of ``small``: a fifth of the weights of ``free``, whose first layer sees 312 numbers."""

PLAIN_WIDTH_RATIO: Final = 1.6
"""Width of a network without symmetry beside that of each of four images, for as many weights a frame."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """One way to train.

    Args:
        name: What ``--recipe`` calls it.
        labels: Hard unit labels, or the touched fraction of each pixel.
        architecture: The network.
        epochs: Passes through the data.
        batch: Samples a step.
        learning_rate: Adam's step, or its peak in a cycle.
        schedule: Constant, or one cycle of rise and fall over the whole run.
        weight_decay: Decoupled decay of the weights a step, times the learning rate.
        average: Decay a step of the running mean of the weights that is validated and exported; 0 takes the last ones.
        noises: Definitions of 50 dB, one drawn for each sample.
        snr_db: Signal-to-noise ratio; of a range each sample has its own.
        correlation_weight: Weight of 1 - correlation beside the cross-entropy.
        flips: Whether each batch is shown in one of the skin's mirror images, drawn at random.
        lost_rows: Share of the samples that lose one to four rows.
        lost_electrode: Share of the samples that lose every row of one electrode.
        predicted_dropout: Share of the samples whose V_pred is replaced by V0, as when none was sent.
        together: Deformations that a batch is drawn from, others for each group of batches; 0 draws from all. The
            cloud channel runs once a deformation and batch.
    """

    name: str
    labels: Labels
    architecture: Architecture
    epochs: int = PAPER_EPOCHS
    batch: int = PAPER_BATCH
    learning_rate: float = PAPER_LEARNING_RATE
    schedule: Schedule = "constant"
    weight_decay: float = 0.0
    average: float = 0.0
    noises: tuple[Noise, ...] = ("N1",)
    snr_db: float | tuple[float, float] = PAPER_SNR_DB
    correlation_weight: float = 0.0
    flips: bool = False
    lost_rows: float = 0.0
    lost_electrode: float = 0.0
    predicted_dropout: float = 0.0
    together: int = 0

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 2:
            raise ValueError(f"epochs {self.epochs} and batch {self.batch}; expected at least 1 epoch and a batch of 2")
        if self.together < 0:
            raise ValueError(f"deformations together are {self.together}; expected 0 for all, or more")
        if self.labels == "area" and self.architecture.outputs != "pixels":
            raise ValueError(f"area labels need pixels as outputs; the architecture has {self.architecture.outputs}")

    def as_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values, for a checkpoint or a manifest."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Recipe":
        """Return the recipe that :meth:`as_dict` wrote.

        Raises:
            ValueError: A key is unknown or missing.
        """
        try:
            architecture: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in values["architecture"].items()
            }
            architecture["outputs"] = STORED_OUTPUTS.get(architecture["outputs"], architecture["outputs"])
            rest: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
            return cls(**{**rest, "architecture": Architecture(**architecture)})
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a recipe of this version: {error}; train again with 'eitskin train'") from error


_PAPER_NETWORK: Final = Architecture(
    voltage_channel="paper",
    log_ratio=False,
    widths=(512, 512, 256),
    convolutions=(8, 16, 8),
    cloud_channels=(16, 8),
    hidden=384,
    outputs="pixels",
    dropout=0.1,
)

_ROBUST: Final = Recipe(
    name="robust",
    labels="area",
    architecture=Architecture(
        widths=(544, 544), hidden=544, log_predicted=True, activation="silu", sharpening=(32, 32)
    ),
    epochs=24,
    batch=512,
    learning_rate=4e-3,
    schedule="onecycle",
    weight_decay=1e-2,
    average=0.999,
    noises=("N1", "N2", "N3"),
    correlation_weight=0.3,
    flips=True,
    lost_rows=0.05,
    lost_electrode=0.1,
    predicted_dropout=0.1,
)


def _units_network(width: int) -> Architecture:
    return replace(
        _ROBUST.architecture, widths=(width,) * 3, hidden=width, outputs="units", sharpening=(), symmetric=True
    )


RECIPES: Final[dict[str, Recipe]] = {
    "paper": Recipe(name="paper", labels="units", architecture=_PAPER_NETWORK),
    "units": replace(
        _ROBUST,
        name="units",
        labels="units",
        architecture=_units_network(256),
        flips=False,
        together=48,
        lost_electrode=0.15,
    ),
    "free": replace(
        _ROBUST,
        name="free",
        architecture=replace(_ROBUST.architecture, widths=(340, 340), hidden=340, symmetric=True),
        flips=False,  # all but the sharpening treats a mirrored batch as the batch
        together=48,
    ),
    "small": replace(
        _ROBUST,
        name="small",
        architecture=replace(
            _ROBUST.architecture, widths=(340, 340), hidden=340, symmetric=True, ranks=RANKS
        ),  # begins with a network of "free"
        epochs=8,
        learning_rate=2e-3,
        flips=False,
        together=48,
    ),
    "small-units": replace(
        _ROBUST,
        name="small-units",
        labels="units",
        architecture=_units_network(136),
        flips=False,
        together=48,
        lost_electrode=0.15,
    ),
    "tiny": replace(
        _ROBUST,
        name="tiny",
        architecture=replace(
            _ROBUST.architecture, widths=(60, 60), cloud_channels=(4, 4), hidden=60, sharpening=(8,), symmetric=True
        ),
        flips=False,
        epochs=4,
        batch=64,
    ),
}
"""Recipes by name."""


def recipe(name: str) -> Recipe:
    """Return a recipe by name.

    Raises:
        ValueError: There is none of that name.
    """
    if name not in RECIPES:
        raise ValueError(f"no recipe is called {name!r}; expected one of {', '.join(RECIPES)}")
    return RECIPES[name]


def fitted(base: Recipe, skin: Skin) -> Recipe:
    """Return a recipe for a skin with fewer mirror images than the paper's four: wider, for as many weights a frame."""
    architecture, images = base.architecture, len(mirrors(skin, near=True))
    if not architecture.symmetric or images == 4:
        return base
    factor = PLAIN_WIDTH_RATIO ** (0.5 if images == 2 else 1.0)
    wider = widened(architecture, factor, images > 1)
    if wider.ranks:
        first, *others = wider.ranks
        wider = replace(wider, ranks=(first, *(round(4 / images / factor * rank) for rank in others)))
    return replace(base, architecture=wider)


def widened(architecture: Architecture, factor: float, symmetric: bool) -> Architecture:
    """Return an architecture with wider layers, with or without symmetry."""
    widths = tuple(round(factor * width) for width in architecture.widths)
    return replace(architecture, widths=widths, hidden=round(factor * architecture.hidden), symmetric=symmetric)
