"""``eitskin bench recording``: the benchmark in ``bench``, its stream in ``stream``."""
