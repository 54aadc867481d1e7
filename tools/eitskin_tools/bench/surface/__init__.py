"""``eitskin bench surface``: the benchmark in ``bench``, its helpers beside it."""
