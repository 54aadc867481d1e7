"""``eitskin flash``: show, compare, write, verify or roll back the configuration of a device."""

import argparse
from typing import Any

from eitskin.acquisition.drivers.driver import driver_name
from eitskin.acquisition.ports import open_line
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.acquisition.transport import Transport
from eitskin_proto.wire import config_toml
from eitskin_proto.wire.codes import HelloFlag
from eitskin_proto.wire.config import Configuration
from eitskin_tools.command_line import files
from eitskin_tools.console.terminal import answer, in_words, note
from eitskin_tools.errors import UsageError
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange

ACTIONS = ("show", "diff", "write", "verify", "rollback")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("action", choices=ACTIONS)
    parser.add_argument(
        "file", nargs="?", help=f"a TOML file, or one of {', '.join(config_toml.NAMED)}; for diff, write and verify"
    )
    parser.add_argument("--port", help="a serial port's path, or usb:SERIAL")
    parser.add_argument("--baud", type=int, default=DEFAULT_BAUD, help="of a real UART (default %(default)s)")
    parser.add_argument("--dry-run", action="store_true", help="check everything, write nothing")
    parser.add_argument("--allow-downgrade", action="store_true", help="replace a higher revision of the same name")


def run(arguments: argparse.Namespace) -> int:
    """Do it and return the exit status: 1 also if diff or verify find a difference."""
    needs_file = arguments.action in ("diff", "write", "verify")
    if needs_file != (arguments.file is not None):
        raise UsageError(f"flash {arguments.action} {'needs a' if needs_file else 'takes no'} FILE")
    if needs_file:
        files.find(arguments.file, files.CONFIGURATION)  # says what there is where there is no such file
    configuration = config_toml.load(arguments.file) if needs_file else None
    if arguments.port is None:
        if arguments.action == "write" and arguments.dry_run and configuration is not None:
            configuration.check()
            return _print(arguments, {"action": "write", "dry_run": True, **_describe(configuration)})
        raise UsageError(f"flash {arguments.action} needs --port; 'eitskin doctor' lists the ports")

    if name := driver_name(arguments.port):
        raise UsageError(f"{arguments.port} is a device of the driver {name}, which is not flashed; set its options")

    def opened() -> Transport:
        return open_line(arguments.port, arguments.baud)

    exchange = Exchange(opened())
    try:
        return _act(arguments, exchange, configuration, opened)
    finally:
        exchange.transport.close()


def _act(arguments: argparse.Namespace, exchange: Exchange, configuration: Configuration | None, opened: Any) -> int:
    if arguments.action == "show":
        shown = procedure.show(exchange)
        return _print(arguments, {"action": "show", **_device(shown)})
    if arguments.action == "rollback":
        if arguments.dry_run:
            return _print(arguments, {"action": "rollback", "dry_run": True, **_device(procedure.show(exchange))})
        hello = procedure.rollback(exchange, opened)
        return _print(
            arguments,
            {"action": "rollback", "configuration": hello.configuration_name, "generation": hello.generation},
        )
    assert configuration is not None
    if arguments.action == "write" and not arguments.dry_run:
        written = _written(exchange, configuration, arguments, opened)
        return _print(arguments, {"action": "write", "generation": written.generation, **_describe(configuration)})
    found = procedure.verify(exchange, configuration)
    listed = [{"field": name, "device": old, "file": new} for name, old, new in found]
    report = {"action": arguments.action, "differences": listed, **_describe(configuration)}
    if arguments.action == "write":
        procedure.check(exchange.hello(), configuration, exchange.transport.line_bytes_per_s)
        return _print(arguments, {**report, "dry_run": True})
    _print(arguments, {**report, "same": not found})
    return 1 if found else 0


def _written(
    exchange: Exchange, configuration: Configuration, arguments: argparse.Namespace, opened: Any
) -> procedure.Stored:
    """Write; an interrupted write says what the device is left with."""
    begun = "begin"

    def progress(step: str) -> None:
        nonlocal begun
        begun = step
        note(f"{step} ...")

    try:
        return procedure.write(
            exchange, configuration, allow_downgrade=arguments.allow_downgrade, progress=progress, reopen=opened
        )
    except KeyboardInterrupt:
        note(f"eitskin flash: interrupted; {procedure.STATE_AFTER[begun]}; see 'eitskin flash show'")
        raise


def _describe(configuration: Configuration) -> dict[str, Any]:
    return {"configuration": configuration.name, "digest": f"{configuration.digest:08x}"}


def _device(shown: procedure.Shown) -> dict[str, Any]:
    def described(one: procedure.Stored | None) -> dict[str, Any] | None:
        if one is None:
            return None
        return {
            **one.configuration.published(),
            "digest": f"{one.configuration.digest:08x}",
            "generation": one.generation,
        }

    hello = shown.hello
    return {
        "serial_number": hello.serial_number,
        "firmware": ".".join(map(str, hello.firmware_version)),
        "flags": [flag.name for flag in HelloFlag if hello.flags & flag],
        "active_state": shown.active_state,
        "active": described(shown.active),
        "other_state": shown.other_state,
        "other": described(shown.other),
    }


def _print(arguments: argparse.Namespace, report: dict[str, Any]) -> int:
    lines = []
    for key, value in report.items():
        if key == "differences":
            for row in value:
                (name, device), (_, file) = (config_toml.in_file(row["field"], row[of]) for of in ("device", "file"))
                lines.append(f"  {name}: device {in_words(device)}, file {in_words(file)}")
        elif isinstance(value, dict):
            lines.append(f"{key}: {value['name']!r}, generation {value['generation']}, digest {value['digest']}")
            for field, content in value.items():
                if field not in ("name", "generation", "digest"):
                    name, shown = config_toml.in_file(field, content)
                    lines.append(f"  {name}: {in_words(shown)}")
        else:
            lines.append(f"{key}: {in_words(value)}")
    return answer(arguments, report, *lines)
