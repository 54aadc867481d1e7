"""From a trained network to a bundle: ONNX graphs, projection matrices, parity with torch, manifest."""
