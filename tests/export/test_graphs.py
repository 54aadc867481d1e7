from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from tests.second_skin import SECOND
from torch import nn

from eitskin.model.onnx_graph import check_graph
from eitskin_export import graphs, parity
from eitskin_export.fold import split
from eitskin_export.package import int8_head
from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_training.network.architecture import Architecture
from eitskin_training.network.model import VD2T
from eitskin_training.recipes import recipe

pytestmark = [pytest.mark.slow, pytest.mark.heavy]


def trained_looking(architecture: Architecture, skin: Skin = PAPER) -> VD2T:
    """Return a network whose batch norms have statistics and scales unlike their first ones."""
    torch.manual_seed(0)
    model = VD2T(architecture, skin).train()
    for _ in range(5):
        model(0.1 * torch.randn(64, 104), torch.randn(64, 3, *skin.grid.shape))
    for module in model.modules():
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.uniform_(module.bias, -0.5, 0.5)
    model.standardise.fit(0.3 + 2.0 * torch.randn(99, len(model.standardise.mean)))
    for block in model.sharpen.blocks:
        nn.init.normal_(block[-1].weight, std=0.3)  # it begins as the identity
    return model.eval()


PLAIN = Architecture(widths=(64, 64), cloud_channels=(4, 4), hidden=48)
SHARPENED = replace(PLAIN, log_predicted=True, activation="silu", sharpening=(8, 8))
SYMMETRIC = replace(PLAIN, widths=(40, 40), hidden=32, symmetric=True)

ARCHITECTURES = {
    "paper": replace(
        PLAIN,
        voltage_channel="paper",
        log_ratio=False,
        widths=(64, 64, 48),
        convolutions=(4, 8, 4),
        hidden=64,
        dropout=0.1,
    ),
    "residual": replace(PLAIN, dropout=0.1),
    "units": replace(PLAIN, outputs="units"),
    "predicted": replace(PLAIN, log_predicted=True),
    "sharpened": SHARPENED,
    "no cloud": replace(PLAIN, use_cloud=False),
    "symmetric": replace(SHARPENED, widths=(40, 40), hidden=32, symmetric=True),
    "narrow": replace(SHARPENED, widths=(40, 40), hidden=40, symmetric=True, ranks=(24, 6, 7, 8)),
    "narrow units": replace(PLAIN, outputs="units", ranks=(24, 20, 20, 16)),
    "symmetric, not sharpened": SYMMETRIC,
    "symmetric units": replace(SYMMETRIC, log_predicted=True, outputs="units"),
}


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_folding_batch_norm_changes_nothing(name: str) -> None:
    model = trained_looking(ARCHITECTURES[name])
    geometry, head = split(model)
    for half in (geometry, head):
        assert not any(isinstance(m, nn.BatchNorm1d | nn.BatchNorm2d | nn.Dropout) for m in half.modules())
    dv, clouds, predicted = (torch.from_numpy(array) for array in parity.stored_inputs(PAPER, 16))
    with torch.inference_mode():
        bias = geometry(clouds)
        found = head(dv, predicted, bias) if model.architecture.log_predicted else head(dv, bias)
        exact = model.double()
        expected = exact.maps(exact(dv.double(), clouds.double(), None, predicted.double()))
    # float32 sums of some 200 products against float64: 1e-6; a forgotten epsilon of batch norm is 1e-5 and more.
    np.testing.assert_allclose(found.numpy(), expected.numpy(), rtol=0, atol=1e-6)


@pytest.fixture(scope="module", autouse=True)
def _first_export() -> None:
    """The first export of a process imports for seconds and solves the stored inputs, which is no test's own time."""
    model = trained_looking(ARCHITECTURES["no cloud"])
    geometry, head = split(model)
    parity.parity(model, graphs.geometry_graph(geometry), graphs.head_graph(head))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("paper", "sharpened", "symmetric", "narrow") else pytest.mark.slow)
        for name in ARCHITECTURES
    ],
)
def test_the_exported_graphs_say_what_the_network_says(name: str) -> None:
    model = trained_looking(ARCHITECTURES[name])
    geometry, head = split(model)
    graph = {"geometry": graphs.geometry_graph(geometry), "head": graphs.head_graph(head)}
    differences = parity.parity(model, graph["geometry"], graph["head"])
    assert set(differences) == {"bias", "map"}
    assert max(differences.values()) < parity.TOLERANCE
    for content in (*graph.values(), int8_head(graph["head"])):
        check_graph(content)  # what the runtime allows
    for content in graph.values():
        assert b".py" not in content, "a stack trace of the exporting machine"
        loaded = onnx.load_from_string(content)
        assert {item.key: item.value for item in loaded.metadata_props} == {
            "protocol_id": PROTOCOL_ID,
            "grid_id": PAPER.grid_id,
        }
    shapes = {
        item.name: [d.dim_value for d in item.type.tensor_type.shape.dim]
        for item in onnx.load_from_string(graph["head"]).graph.input
    }
    bias = [1, model.bias_width]
    expected: dict[str, list[int]] = {"dv": [1, 104], "bias": bias}
    assert shapes == (expected | {"log_predicted": [1, 104]} if model.architecture.log_predicted else expected)


@pytest.fixture(scope="module")
def second() -> tuple[bytes, bytes, float]:
    """The graphs of a network of another skin, and by how much they differ from it."""
    model = trained_looking(ARCHITECTURES["symmetric"], SECOND)
    halves = split(model)
    geometry, head = graphs.geometry_graph(halves[0]), graphs.head_graph(halves[1])
    return geometry, head, max(parity.parity(model, geometry, head).values())


def test_the_graphs_of_another_skin_carry_its_id_and_have_its_shapes(second: tuple[bytes, bytes, float]) -> None:
    geometry_bytes, head_bytes, difference = second
    assert difference < parity.TOLERANCE
    for content in (geometry_bytes, int8_head(head_bytes)):
        check_graph(content)
        props = {item.key: item.value for item in onnx.load_from_string(content).metadata_props}
        assert props["grid_id"] == SECOND.grid_id


def test_a_network_in_training_mode_is_not_exported() -> None:
    _, head = split(trained_looking(ARCHITECTURES["residual"]))
    with pytest.raises(SkinError, match="training mode"):
        graphs.head_graph(head.train())


def test_a_folded_network_that_kept_its_dropout_is_refused_when_exported() -> None:
    _, head = split(trained_looking(ARCHITECTURES["residual"]))
    dropout = nn.Dropout(0.5)
    head.voltage = nn.Sequential(head.voltage, dropout)
    head.eval()
    dropout.train()  # what an export in training mode would silently keep
    with pytest.raises(SkinError, match="Dropout"):
        graphs.head_graph(head)


@pytest.mark.slow
def test_the_int8_head_is_close_smaller_and_keeps_its_first_layer_exact() -> None:
    model = trained_looking(recipe("free").architecture)
    geometry, head = split(model)
    geometry_bytes, head_bytes = graphs.geometry_graph(geometry), graphs.head_graph(head)
    int8 = int8_head(head_bytes)
    assert len(int8) < 0.4 * len(head_bytes)
    error = parity.int8_error(geometry_bytes, head_bytes, int8, *parity.stored_inputs(PAPER, 16))
    assert 0.0 < error["rms"] < 5e-3
    kinds = [node.op_type for node in onnx.load_from_string(int8).graph.node]
    first = next(index for index, kind in enumerate(kinds) if kind in {"Gemm", "MatMul", "MatMulInteger"})
    assert kinds[first] != "MatMulInteger"
    assert kinds.count("MatMulInteger") == len(model.architecture.widths) + 1
