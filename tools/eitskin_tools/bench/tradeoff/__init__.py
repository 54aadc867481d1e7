"""``eitskin bench tradeoff``: the benchmark in ``bench``, its helpers beside it."""
