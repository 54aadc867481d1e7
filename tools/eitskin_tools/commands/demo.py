"""``eitskin demo``: the main job in one command."""

import argparse
import signal

from eitskin_tools.command_line import options
from eitskin_tools.command_line.parser import positive
from eitskin_tools.console.terminal import answer
from eitskin_tools.processes.signals import endings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--seconds", type=positive(), metavar="S", help="run time after the first frame (20; with --view 3600)"
    )
    parser.add_argument("--rate", type=positive(1e5), default=200.0, metavar="HZ", help="frames a second (default 200)")
    options.add_bundle(parser, "to run (default: a shipped one that knows the touches)")
    options.add_touches(parser, "those of the bundle, presses where it knows them or one that does is shipped")
    parser.add_argument(
        "--solver",
        metavar="NAME",
        help="most accurate solver to use: vd2t, vd2t-int8, vd2t-small or tikhonov (default: vd2t-int8 where the "
        "bundle's card says that it shows the same, else vd2t)",
    )
    parser.add_argument(
        "--device", default="virtual", choices=("virtual", "qemu"),
        help="qemu: the real firmware on an emulated board (needs qemu-system-arm and gcc-arm-none-eabi)",
    )  # fmt: skip
    parser.add_argument("--noise", default="N2", choices=("N1", "N2", "N3", "none"), help="at 50 dB (default N2)")
    parser.add_argument("--view", action="store_true", help="show it in the browser, until Ctrl-C")


def run(arguments: argparse.Namespace) -> int:
    """Run the demonstration."""
    from eitskin_tools.demo.show import Options, choose, lines_of, stream, summarise

    seconds = arguments.seconds if arguments.seconds is not None else 3600.0 if arguments.view else 20.0
    options.check_solver(arguments)
    bundle, kind = choose(arguments.bundle, arguments.touches)
    for number in endings():
        signal.signal(number, signal.default_int_handler)  # ends as by Ctrl-C, leaving nothing behind
    wanted = Options(
        seconds=seconds,
        rate_hz=arguments.rate,
        bundle=bundle,
        touches=kind,
        solver=arguments.solver,
        noise=arguments.noise,
        device=arguments.device,
        view=arguments.view,
        talk=not arguments.json,
    )
    summary = summarise(wanted, stream(wanted))
    return answer(arguments, summary, *lines_of(summary))
