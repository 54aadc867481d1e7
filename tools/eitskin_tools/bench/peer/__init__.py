"""A peer's sensor and reader beside ours: the same payloads, at the same rate, over the same kind of port.

::

    sensor.py            a process: a pty on which frames go out at a rate, whole or with one bit flipped each
    frames.py            what a frame holds, and how either format wraps it
    reader_eitskin.py    a process: frames as eitskin's transport and framing give them
    reader_flexitac.py   a process in a virtual environment of its own: frames as flexitac gives them
    environment.py       makes that virtual environment
    compare.py           runs all of them and counts
"""
