"""ONNX files cut down to what a region needs, without the ``onnx`` package."""
