"""The parameters of a network's shape apart from its skin, as plain values for a recipe and a manifest."""

from dataclasses import dataclass
from typing import Final, Literal, get_args

VoltageChannel = Literal["paper", "residual"]
Activation = Literal["relu", "silu"]
Outputs = Literal["pixels", "units"]

STORED_OUTPUTS: Final[dict[int, Outputs]] = {1350: "pixels", 126: "units"}
"""What files from before skins were described say: numbers of the paper's sheet."""


@dataclass(frozen=True, slots=True)
class Architecture:
    """The parameters of a network's shape for a given skin.

    Args:
        voltage_channel: The paper's MLP and 1-D CNN, or residual linear layers.
        log_ratio: Whether log(V / V0) joins dv as an input, computed inside the graph.
        log_predicted: Whether log(V / V_pred) does; V_pred then comes as a second input of the head.
        widths: Outputs of each linear layer of the voltage channel; a residual channel needs them equal.
        convolutions: Channels of each 1-D convolution of the paper's voltage channel.
        cloud_channels: Channels of each 2-D convolution of the cloud channel.
        use_cloud: False leaves the cloud out, for the ablation; the bias is then a constant.
        hidden: Width H between the two fusion layers, and so of the bias.
        outputs: The map's pixels, or the units that the graph spreads over their pixels.
        dropout: Fraction of activations dropped in training.
        activation: ReLU, as in the paper, or SiLU, which learns more in as many epochs.
        sharpening: Channels of each block that sharpens the map; none leaves it as the last linear layer gives it.
        symmetric: Whether every layer but the sharpening keeps the skin's mirror symmetries; widths are then those of
            one image. Residual voltage channels only.
        ranks: Of each linear layer that a frame passes, in order: the voltage channel's, the first fusion layer, the
            last one. Such a layer becomes two, with this many features of each image in between; none leaves all whole.
            A frame is 104 numbers, so a wide layer's weights are mostly not needed.
    """

    voltage_channel: VoltageChannel = "residual"
    log_ratio: bool = True
    log_predicted: bool = False
    widths: tuple[int, ...] = (512, 512, 512)
    convolutions: tuple[int, ...] = ()
    cloud_channels: tuple[int, ...] = (8, 8)
    use_cloud: bool = True
    hidden: int = 512
    outputs: Outputs = "pixels"
    dropout: float = 0.0
    activation: Activation = "relu"
    sharpening: tuple[int, ...] = ()
    symmetric: bool = False
    ranks: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.outputs not in get_args(Outputs):
            raise ValueError(f"outputs is {self.outputs!r}; expected one of {', '.join(get_args(Outputs))}")
        if self.voltage_channel == "residual" and len(set(self.widths)) != 1:
            raise ValueError(f"widths of a residual channel are {self.widths}; expected all equal")
        if self.sharpening and self.outputs != "pixels":
            raise ValueError(f"sharpening needs pixels as outputs, found {self.outputs}: units have no pixels around")
        if self.symmetric and self.voltage_channel != "residual":
            raise ValueError("a symmetric network needs a residual voltage channel")
        if self.ranks and (self.voltage_channel != "residual" or len(self.ranks) != len(self.widths) + 2):
            raise ValueError(
                f"ranks are {self.ranks}; expected {len(self.widths) + 2} of a residual channel, one a layer, or none"
            )
        if self.ranks and min(self.ranks) < 1:
            raise ValueError(f"ranks are {self.ranks}; expected at least 1 each")
        if not 0.0 <= self.dropout < 1.0:
            raise ValueError(f"dropout is {self.dropout}; expected 0 <= dropout < 1")

    @property
    def feature_blocks(self) -> int:
        """How many times 104 values the voltage channel reads."""
        return 1 + self.log_ratio + self.log_predicted
