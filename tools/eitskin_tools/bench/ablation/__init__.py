"""``eitskin bench ablation``: the benchmark in ``bench``, its helpers beside it."""
