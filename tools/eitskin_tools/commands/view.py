"""``eitskin view``: a live page in the browser."""

import argparse
import contextlib
import gc
import os
import re
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from eitskin_proto.files.plain import quoted
from eitskin_tools.command_line import options
from eitskin_tools.command_line.parser import whole
from eitskin_tools.console.terminal import has_display, say
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.signals import endings

PORT = 8416
"""Default."""

POLL_S = 0.2
"""Longest delay of Ctrl-C."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file", nargs="?", type=Path, metavar="FILE.mcap", help="a recording to show (default: the running skin)"
    )
    parser.add_argument("--endpoint", metavar="E", help="where the runtime publishes (default: its default)")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="ROBOT.toml",
        help="show all skins of a robot.toml, or of a running 'eitskin run --config' by its folder",
    )
    options.add_bundle(parser, "that computes a recording's maps (default: the one that was running)")
    parser.add_argument(
        "--port", type=whole(0, 65535), default=PORT, metavar="N", help=f"port of the page, 0 for any ({PORT})"
    )
    parser.add_argument("--host", default="127.0.0.1", metavar="A", help="address to serve on (127.0.0.1)")
    parser.add_argument(
        "--allow-host",
        action="append",
        default=[],
        metavar="NAME",
        help="answer requests to this host name too, such as a proxy's; may be repeated",
    )
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help="folder for recordings made from the page (default: this one)"
    )
    parser.add_argument("--no-open", action="store_true", help="do not open a browser")
    options.add_skin(parser, "the sheet's size, so that places are in mm")
    options.add_client_keys(parser)


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C and return 0."""
    _check(arguments)
    for number in endings():
        signal.signal(number, signal.default_int_handler)  # a script's "&" has it ignore Ctrl-C, which ends it
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.suppress(KeyboardInterrupt))
        where = {"host": arguments.host, "port": arguments.port, "allowed": arguments.allow_host}
        what, address = _recorded(arguments, where, stack) if arguments.file else _live(arguments, where, stack)
        say(f"viewing {what} at {address} until Ctrl-C")
        sys.stdout.flush()
        if not arguments.no_open and has_display(sys.stdout):
            import webbrowser

            webbrowser.open(address)
        ended = threading.Event()
        while not ended.wait(POLL_S):  # a signal that comes just before a wait does not end that one
            pass
    gc.freeze()  # the process ends: a search for cycles among its modules would take as long as all of the above
    return 0


def _check(arguments: argparse.Namespace) -> None:
    for name in arguments.allow_host:
        if not re.fullmatch(r"[\w.-]+|[0-9a-f:]+", name, re.IGNORECASE):
            raise UsageError(
                f"--allow-host is {quoted(name)}, expected a name or an address alone, such as robot.example.com: "
                "leave https:// and the port out"
            )
    live = {"--endpoint": arguments.endpoint, "--config": arguments.config, "--server-key": arguments.server_key}
    stated = [name for name, value in live.items() if value is not None]
    if arguments.file is not None and stated:
        raise UsageError(f"a recording needs no runtime: leave {' and '.join(stated)} out")
    if arguments.file is None and arguments.bundle is not None:
        raise UsageError("--bundle is for recordings, as a runtime computes its own maps; leave it out")
    if arguments.endpoint is not None and arguments.config is not None:
        raise UsageError("--config names the endpoints of all skins; leave --endpoint out")
    if arguments.recordings is not None and not arguments.recordings.is_dir():
        raise UsageError(f"--recordings is {arguments.recordings}, expected an existing folder")
    if arguments.recordings is not None and _writable(arguments.recordings) is None:
        raise UsageError(
            f"--recordings is {arguments.recordings}, which this user cannot write to; name another folder"
        )


def _recorded(arguments: argparse.Namespace, where: dict[str, Any], stack: contextlib.ExitStack) -> tuple[str, str]:
    """Serve a recording; return what and where."""
    from eitskin_tools.view.film import Film, FilmServer

    film = Film(arguments.file, arguments.bundle)
    page = stack.enter_context(FilmServer(film, **where))
    return str(arguments.file), page.address


def _live(arguments: argparse.Namespace, where: dict[str, Any], stack: contextlib.ExitStack) -> tuple[str, str]:
    """Serve one runtime or several; return what and where."""
    from eitskin_tools.view.source import Source, sources_of
    from eitskin_tools.view.viewer import Viewer

    keys = options.client_keys(arguments)
    key_options = tuple(f"--{name}={value}" for name, value in (("server-key", arguments.server_key),
                    ("client-key", arguments.client_key)) if value is not None)  # fmt: skip
    skin, config = options.chosen_skin(arguments), arguments.config
    if config is None:
        sources: tuple[Source, ...] = (Source(skin, arguments.endpoint, keys=keys, record_options=key_options),)
    else:
        sources = sources_of(config, skin, keys=keys, record_options=key_options)
    recordings = _writable(arguments.recordings or Path())
    viewer = stack.enter_context(Viewer(sources, recordings=recordings, **where))
    names = f"{', '.join(one.name for one in sources)} of {config}" if config else viewer.feeds[0].endpoint
    return names, viewer.address


def _writable(folder: Path) -> Path | None:
    """Return a folder for recordings, or None where they cannot be written."""
    return folder.resolve() if os.access(folder, os.W_OK | os.X_OK) else None
