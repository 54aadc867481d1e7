"""``eitskin bench memory``: the benchmark in ``bench``, its helpers beside it."""
