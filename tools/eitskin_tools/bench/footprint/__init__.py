"""``eitskin bench footprint``: the benchmark in ``bench``, its helpers beside it."""
