"""``eitskin view``: a live page in the browser."""

import argparse
import contextlib
import os
import signal
import sys
import threading
from pathlib import Path

from eitskin_tools.command_line import skins
from eitskin_tools.console.say import say
from eitskin_tools.errors import UsageError

PORT = 8416
"""Unless another one is named."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE.mcap", help="look at a recording, over and over")
    parser.add_argument("--endpoint", metavar="E", help="where the runtime publishes (default: its default)")
    parser.add_argument("--port", type=int, default=PORT, metavar="N", help=f"of the page, 0 for any ({PORT})")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="A",
        help="address to serve on (127.0.0.1); any other than this machine's own asks for a token",
    )
    parser.add_argument("--token", action="store_true", help="ask for a token on this machine too")
    parser.add_argument("--recordings", type=Path, metavar="DIR", help="where the page's recordings go (default: here)")
    parser.add_argument("--no-open", action="store_true", help="do not open a browser")
    skins.add_skin(parser, "the sheet's size, so that places are in mm")
    parser.add_argument("--server-key", type=Path, metavar="FILE", help="CURVE: server.key of the runtime")
    parser.add_argument("--client-key", type=Path, metavar="FILE", help="CURVE: our own .key_secret")


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C and return 0."""
    if (arguments.server_key is None) != (arguments.client_key is None):
        raise UsageError("--server-key and --client-key belong together")
    if not 0 <= arguments.port <= 65535:
        raise UsageError(f"--port is {arguments.port}, expected 0 to 65535")
    if arguments.file is not None and (arguments.endpoint is not None or arguments.server_key is not None):
        raise UsageError("a recording is played by the viewer itself: leave --endpoint and the keys out")
    from eitskin.messaging.curve_keys import load_client_keys
    from eitskin_tools.view.address import is_loopback, new_token
    from eitskin_tools.view.played import played
    from eitskin_tools.view.viewer import Viewer

    keys = load_client_keys(arguments.server_key, arguments.client_key) if arguments.server_key else None
    options = [f"--{name}={value}" for name, value in (("server-key", arguments.server_key),
               ("client-key", arguments.client_key)) if value is not None]  # fmt: skip
    token = new_token() if arguments.token or not is_loopback(arguments.host) else ""
    skin, folder = skins.chosen(arguments), arguments.recordings or Path()
    if not folder.is_dir():
        raise UsageError(f"--recordings is {folder}, expected a folder that is there")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a script's "&" has it ignore Ctrl-C, which ends it
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.suppress(KeyboardInterrupt))
        player = None if arguments.file is None else stack.enter_context(played(arguments.file))
        viewer = stack.enter_context(
            Viewer(
                player.endpoint if player else arguments.endpoint, skin, host=arguments.host, port=arguments.port,
                token=token, keys=keys, recordings=None if player else _writable(folder),
                record_options=tuple(options), file=player.name if player else "",
            )
        )  # fmt: skip
        say(f"viewing {arguments.file or viewer.endpoint} at {viewer.address} until Ctrl-C")
        sys.stdout.flush()
        if not arguments.no_open and _has_display():
            import webbrowser

            webbrowser.open(viewer.address)
        if player is None:
            threading.Event().wait()
        else:
            player.wait()
    return 0


def _writable(folder: Path) -> Path | None:
    """Return a folder for recordings, or None where they cannot be written."""
    return folder.resolve() if os.access(folder, os.W_OK) else None


def _has_display() -> bool:
    """Return whether somebody sits there who could see a browser."""
    return sys.stdout.isatty() and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
