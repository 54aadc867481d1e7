"""``eitskin demo``: the main job in one command."""

import argparse
import json
import signal
import sys
from pathlib import Path

from eitskin_tools.command_line import files, kinds, options
from eitskin_tools.processes.signals import endings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="run time after the first frame (20; with --view 3600)"
    )
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="frames a second (default 200)")
    options.add_bundle(parser, "to run (default: a shipped one that knows the touches)")
    options.add_touches(parser, "those of the bundle, presses where it knows them or one that does is shipped")
    parser.add_argument(
        "--solver",
        metavar="NAME",
        help="most accurate solver to use: vd2t, vd2t-int8, vd2t-small or tikhonov (default: vd2t-int8 where the "
        "bundle's card says that it shows the same, else vd2t)",
    )
    parser.add_argument(
        "--scene", metavar="FILE", help="show this scene only (a file, or sample); default: touches come and go"
    )
    parser.add_argument(
        "--device", default="virtual", choices=("virtual", "qemu"),
        help="qemu: the real firmware on an emulated board (needs qemu-system-arm and gcc-arm-none-eabi)",
    )  # fmt: skip
    parser.add_argument("--noise", default="N2", choices=("N1", "N2", "N3", "none"), help="at 50 dB (default N2)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default 0)")
    parser.add_argument("--view", action="store_true", help="show it in the browser, until Ctrl-C")
    parser.add_argument("--no-draw", action="store_true", help="do not draw the map in the terminal")
    parser.add_argument("--record", type=Path, metavar="FILE.npz", help="store what the subscriber received")
    parser.add_argument(
        "--picture", type=Path, metavar="FILE.png", help="draw a frame of this run and the truth below it"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Run the demonstration."""
    from eitskin_tools.demo.show import Options, choose, draw_picture, print_summary, stream, summarise

    seconds = arguments.seconds if arguments.seconds is not None else 3600.0 if arguments.view else 20.0
    options.check_positive(arguments, "seconds")
    options.check_positive(arguments, "rate", most=1e5)
    options.check_seed(arguments.seed)
    options.check_solver(arguments)
    scene = None if arguments.scene is None else files.find(arguments.scene, files.SCENE)
    if arguments.record is not None:
        files.writable(arguments.record, kinds.DEMO_RECORD)
    if arguments.picture is not None:
        files.picture(arguments.picture, (".png",))
    bundle, kind = choose(arguments.bundle, options.chosen_touches(arguments))
    for number in endings():
        signal.signal(number, signal.default_int_handler)  # ends as by Ctrl-C, leaving nothing behind
    draw = sys.stdout.isatty() and not (arguments.no_draw or arguments.view) and not arguments.json
    wanted = Options(
        seconds=seconds,
        rate_hz=arguments.rate,
        bundle=bundle,
        touches=kind,
        solver=arguments.solver,
        scene=scene,
        noise=arguments.noise,
        device=arguments.device,
        seed=arguments.seed,
        draw=draw,
        view=arguments.view,
        talk=not draw and not arguments.json,
        record=arguments.record,
    )
    streamed = stream(wanted)
    summary = summarise(wanted, streamed)
    if arguments.json:
        print(json.dumps(summary), flush=True)
    else:
        print_summary(summary)
    if arguments.picture is not None:  # last: a run without a frame worth drawing has a summary all the same
        draw_picture(wanted, streamed, arguments.picture)
    return 0
