"""Fixtures of the pipeline's tests: a pipeline with a reference, and the counts of a touch."""

import numpy as np
import pytest

from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference


@pytest.fixture
def pipeline(tiny, hello, counts):
    pipeline = Pipeline(tiny, hello)
    pipeline.use_reference(Reference(counts * 1e-9, counts * 0.0, 2, "TEST-1", 0xABCD, "paper", ""))
    pipeline.start_with(GeometryGraph(tiny).geometry(None, None, 0))
    return pipeline


@pytest.fixture
def touched(counts):
    return np.rint(counts * (1 + 0.3 * np.cos(np.arange(104)))).astype(np.int32)
