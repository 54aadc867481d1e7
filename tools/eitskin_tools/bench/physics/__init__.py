"""``eitskin bench physics``: the benchmark in ``bench``, its helpers beside it."""
