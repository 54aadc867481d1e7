"""``eitskin bench electrodes``: the benchmark in ``bench``, its helpers beside it."""
