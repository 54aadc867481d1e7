"""How tests pass one frame through a pipeline."""

import time

from eitskin_proto.wire.frames import Frame


def payload(counts, sequence, **fields):
    return Frame(sequence=sequence, device_us=sequence * 5000, counts=counts, **fields).pack()


def go(pipeline, packed, wanted=True):
    return pipeline.accept(packed, time.perf_counter_ns()) and pipeline.compute(wanted)
