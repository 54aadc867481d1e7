"""``eitskin bench dataset``: the benchmark in ``bench``, its helpers beside it."""
