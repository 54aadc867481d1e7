"""``eitskin bench frame``: the benchmark in ``bench``, its helpers beside it."""
