"""``eitskin virtual-skin``: a virtual skin behind a pseudo-terminal."""

import argparse
import os
from pathlib import Path

from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.command_line.options import SEED, SNR_DB
from eitskin_tools.command_line.parser import positive
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--rate", type=positive(1e5), default=200.0, metavar="HZ", help="frames a second (default 200)")
    parser.add_argument(
        "--config",
        default="paper",
        metavar="NAME",
        help="configuration: a TOML file, or paper, full208, idle or fast (default paper)",
    )
    parser.add_argument(
        "--scene", metavar="FILE", help="show this scene only (a file, or sample); default: a script of 20 s loops"
    )
    options.add_skin(parser, "sheet, electrodes, map and which way touches change conductance")
    options.add_touches(parser, "those of the skin, else raise", "how the script's touches change conductance")
    parser.add_argument("--seconds", type=positive(), metavar="S", help="end after S seconds")
    parser.add_argument("--seed", type=SEED, default=0, help="seed of noise and faults (default 0)")
    parser.add_argument("--noise", default="N2", choices=("N1", "N2", "N3", "none"), help="kind of noise (default N2)")
    parser.add_argument("--snr-db", type=SNR_DB, default=50.0, metavar="DB", help="signal to noise ratio (default 50)")
    parser.add_argument(
        "--fault", action="append", default=[], metavar="KIND[@START][/EVERY][:AMOUNT]",
        help="repeatable; KIND: flip drop garbage stall unplug reset saturate foreign mute late twice "
        "frozen stuck failing",
    )  # fmt: skip
    parser.add_argument("--serial-number", default="VIRTUAL-0001", help="serial number in HELLO (default VIRTUAL-0001)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="log events to this file, a JSON object a line")
    parser.add_argument(
        "--wire-times", type=Path, metavar="FILE.npy", help="write the host time of every frame to this file"
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve until stopped."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is first imported, below
    from eitskin_tools.scripted_scene.script import script_of
    from eitskin_tools.virtual_skin.faults import parse
    from eitskin_tools.virtual_skin.process import serve

    if arguments.scene is not None and arguments.touches is not None:
        raise UsageError(
            "--touches does nothing with --scene, which sets how its touches change conductance: leave it out"
        )
    files.find(arguments.config, files.CONFIGURATION)
    scene = None if arguments.scene is None else files.find(arguments.scene, files.SCENE)
    for path, written in ((arguments.wire_times, kinds.ARRAY), (arguments.log, kinds.LOG)):
        if path is not None:
            files.writable(path, written)
    skin, kind = options.chosen_skin(arguments), arguments.touches
    try:
        faults = tuple(parse(text) for text in arguments.fault)
    except ValueError as error:
        raise UsageError(str(error)) from error
    script = script_of(scene, skin if kind is None else skin.touched(kind))
    return serve(arguments, script, faults)
