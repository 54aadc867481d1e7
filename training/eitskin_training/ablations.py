"""Ablations: what each input of the network, and the number of deformations, is worth.

Every variant sees the same touch sets, noises, seed, batch size, schedule and number of samples; one thing differs::

    none          voltages alone
    cloud         the measured shape through the recipe's small CNN
    paper-cloud   the measured shape through a CNN of the paper's kind (paper section IV.B)
    predicted     log(V / V_pred), V_pred by the forward model on the measured shape, without a CNN
    post          log(V / V_post), the true untouched voltages of the bent sheet: what no robot has, the bound
    both          predicted and cloud together, as in the recipe
    unsharpened   both, and the map as the last linear layer gives it
    cross-entropy both, and a loss without the correlation
    unmirrored    both, and layers that do not know the sheet's mirror symmetries, of as many weights a frame

A network that takes a shape is also scored with another deformation's shape in its place ("wrong"): one that does not
get worse does not use it. Training is on family A alone; the scores are of touch sets held out, at deformations of A
never trained on and at family B.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.log_prediction import log_prediction
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import OF_AN_IMAGE, Recipe, widened
from eitskin_training.run_files import network
from eitskin_training.samples.batches import TrainingData
from eitskin_training.score import Score, score, untouched_peaks
from eitskin_training.train import train

PAPER_CLOUD_CHANNELS: Final = (16, 8)
"""Two 2-D convolutions, as the paper's cloud channel has; their widths are ours."""

VARIANTS: Final = (
    "none", "cloud", "paper-cloud", "predicted", "post", "both", "unsharpened", "cross-entropy", "unmirrored",
)  # fmt: skip
"""What can be compared."""

WITH_BOTH: Final = ("both", "unsharpened", "cross-entropy", "unmirrored")
"""Variants that take the prediction and the cloud."""


@dataclass(frozen=True, slots=True)
class Result:
    """What one variant scored.

    Args:
        variant: Which inputs.
        deformations: How many it was trained on.
        samples: Samples of an epoch.
        weights: Weights that one frame reads.
        cc_A: Mean correlation at deformations of A never trained on.
        worst_bend_cc_A: Of the worst of them.
        cc_B: Mean correlation at family B.
        cc_wrong_A: With another deformation's shape; None where no shape is taken.
        untouched_share: Share of untouched, deformed, noisy sheets on which a pixel reaches one half.
        untouched_peak: The highest pixel of any of them.
        seconds: Training time.
    """

    variant: str
    deformations: int
    samples: int
    weights: int
    cc_A: float
    worst_bend_cc_A: float
    cc_B: float
    cc_wrong_A: float | None
    untouched_share: float
    untouched_peak: float
    seconds: float

    def to_json(self) -> dict[str, str | int | float | None]:
        """Return plain values, rounded."""
        return {name: round(v, 4) if isinstance(v, float) else v for name, v in asdict(self).items()}


def variant_recipe(base: Recipe, variant: str) -> Recipe:
    """Return a recipe whose network takes a variant's inputs.

    Raises:
        ValueError: The variant is unknown, or leaves out what the recipe does not have.
    """
    if variant not in VARIANTS:
        raise ValueError(f"variant {variant!r} is unknown; expected one of {', '.join(VARIANTS)}")
    channels = PAPER_CLOUD_CHANNELS if variant == "paper-cloud" else base.architecture.cloud_channels
    unmirrored = variant == "unmirrored"
    if unmirrored and not base.architecture.symmetric:
        raise ValueError(f"recipe {base.name!r} knows no symmetry that variant 'unmirrored' could leave out")
    architecture = replace(
        widened(base.architecture, OF_AN_IMAGE, symmetric=False) if unmirrored else base.architecture,
        log_predicted=variant in ("predicted", "post", *WITH_BOTH),
        use_cloud=variant in ("cloud", "paper-cloud", *WITH_BOTH),
        cloud_channels=channels,
        sharpening=() if variant == "unsharpened" else base.architecture.sharpening,
    )
    weight = 0.0 if variant == "cross-entropy" else base.correlation_weight
    return replace(
        base,
        name=f"{base.name}-{variant}",
        architecture=architecture,
        predicted_dropout=0.0,
        correlation_weight=weight,
        flips=base.flips or unmirrored,
    )


def variant_data(data: TrainingData, variant: str, deformations: int | None, samples: int, seed: int) -> TrainingData:
    """Return a data set with a variant's prediction, and rows of the first so many deformations.

    There are always ``samples`` rows, some of them repeatedly where there are fewer: a smaller choice of deformations
    must not mean fewer steps.
    """
    if variant == "post":
        data = replace(data, log_predicted=log_prediction(data.untouched, data.reference))
    rows = data.train
    if deformations is not None:
        kept = np.unique(data.deformation[rows])[:deformations]
        rows = rows[np.isin(data.deformation[rows], kept)]
    chosen = np.resize(np.random.default_rng([seed, len(rows)]).permutation(rows), samples)
    return replace(data, train=np.sort(chosen))


def wrong_shapes(data: TrainingData, seed: int) -> TrainingData:
    """Return the data set with every deformation's cloud and prediction taken from another of the same split."""
    rng = np.random.default_rng(seed)
    order = np.arange(len(data.clouds))
    for rows in (data.train, *data.held_out.values()):
        own = np.unique(data.deformation[rows])
        mixed = rng.permutation(own)
        order[mixed] = np.roll(mixed, 1)  # one cycle: no deformation keeps its own
    return replace(data, clouds=data.clouds[order], log_predicted=data.log_predicted[order])


def ablate(
    data: TrainingData,
    base: Recipe,
    variants: Sequence[tuple[str, int | None]],
    *,
    samples: int,
    seed: int = 0,
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[Result]:
    """Yield the result of each (variant, number of deformations); None takes all deformations.

    Args:
        data: A data set with deformations of A and B kept apart.
        base: Recipe that every variant changes in one thing.
        variants: What to compare.
        samples: Samples of an epoch, the same for all, so that fewer deformations do not mean fewer samples.
        seed: Of the networks, the noise and the choice of samples.
        tell: Told what is being done.

    Raises:
        ValueError: A variant is unknown, or the data set lacks deformations kept apart.
    """
    if missing := {"A", "B"} - set(data.held_out):
        families = " and ".join(sorted(missing))
        raise ValueError(f"the data set keeps no deformations of {families} apart; make one with --kept")
    for variant, deformations in variants:
        tell(f"{variant}, {deformations or 'all'} deformations")
        recipe, own = variant_recipe(base, variant), variant_data(data, variant, deformations, samples, seed)
        with TemporaryDirectory() as folder:
            run = train(own, recipe, Path(folder) / "run", seed=seed)
        model = network(recipe, run.averaged, own.skin)
        in_a, in_b = (score(model, own, own.held_out[family], recipe.noises) for family in ("A", "B"))
        wrong: Score | None = None
        if recipe.architecture.use_cloud or recipe.architecture.log_predicted:
            wrong = score(model, wrong_shapes(own, seed), own.held_out["A"], recipe.noises)
        peaks = _untouched(model, own, recipe)
        yield Result(
            variant=variant,
            deformations=len(np.unique(own.deformation[own.train])),
            samples=len(own.train),
            weights=model.streamed_weights(),
            cc_A=in_a.cc,
            worst_bend_cc_A=in_a.worst_bend_cc,
            cc_B=in_b.cc,
            cc_wrong_A=None if wrong is None else wrong.cc,
            untouched_share=float((peaks > 0.5).mean()),
            untouched_peak=float(peaks.max()),
            seconds=sum(epoch.seconds for epoch in run.history),
        )


def _untouched(model: VD2T, data: TrainingData, recipe: Recipe) -> npt.NDArray[np.float32]:
    apart = np.unique(np.concatenate([data.deformation[rows] for rows in data.held_out.values()]))
    return untouched_peaks(model, data, apart, recipe.noises)
