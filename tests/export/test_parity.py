"""The comparison of exported graphs with their network can fail."""

import pytest
import torch
from tests.export.test_graphs import ARCHITECTURES, trained_looking

from eitskin_export import graphs, parity
from eitskin_export.fold import split
from eitskin_proto.errors import SkinError

pytestmark = [pytest.mark.slow, pytest.mark.heavy]


def test_parity_fails_for_another_network() -> None:
    model = trained_looking(ARCHITECTURES["residual"])
    geometry, head = split(model)
    with torch.no_grad():
        model.out.bias += 1e-3
    with pytest.raises(SkinError, match="differ from the network"):
        parity.parity(model, graphs.geometry_graph(geometry), graphs.head_graph(head))
