"""``eitskin status``: the state of a running runtime, or of all skins of a robot; exits with 0 only if each is well.

A runtime is well if it answers and processed usable frames between two looks.
"""

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from eitskin_tools.command_line import options
from eitskin_tools.command_line.parser import positive
from eitskin_tools.console.terminal import answer

if TYPE_CHECKING:
    from eitskin.messaging.curve_keys import ClientKeys
    from eitskin.robot.described import ProcessState

INTERVAL_S = 0.5
"""Between two looks: at 200 frames/s some hundred frames."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "where",
        nargs="?",
        help="control endpoint of a runtime (default: its default one); with --all a robot.toml, or the folder of "
        "'eitskin run --config' (default: its default one)",
    )
    parser.add_argument("--all", action="store_true", help="all skins of a robot")
    parser.add_argument(
        "--timeout-s", type=positive(), default=3.0, metavar="T", help="wait T s for answers (default 3)"
    )
    options.add_client_keys(parser)


def run(arguments: argparse.Namespace) -> int:
    """Ask, say, and return 0 if all are well."""
    from eitskin.messaging.endpoints import default_control
    from eitskin.robot.config import RobotSkin
    from eitskin.robot.described import ProcessState, states_of

    keys = options.client_keys(arguments)
    if arguments.all:
        states = states_of(arguments.where)
    else:
        states = (ProcessState(RobotSkin("eitskin", "", arguments.where or default_control())),)
    rows = looked_at(states, arguments.timeout_s, keys)
    well = sum(bool(row["well"]) for row in rows)
    answer(
        arguments, {"skins": rows, "well": well, "of": len(rows)}, *(f"{row['name']}: {row['text']}" for row in rows)
    )
    return 0 if well == len(rows) else 1


def looked_at(states: "tuple[ProcessState, ...]", timeout_s: float, keys: "ClientKeys | None") -> list[dict[str, Any]]:
    """Return how each skin is, after two looks at all of them at once.

    Args:
        states: As robot.json or robot.toml has them.
        timeout_s: For each answer.
        keys: CURVE keys, for TCP.
    """

    def ask(one: "ProcessState") -> tuple[float, dict[str, Any]]:
        from eitskin.errors import SkinError
        from eitskin.messaging.control_client import request

        try:
            answer = request(one.skin.control, "status", timeout_s=timeout_s, keys=keys)
        except SkinError as error:
            answer = {"error": str(error)}
        return time.monotonic(), answer

    with ThreadPoolExecutor(len(states)) as pool:
        first = list(pool.map(ask, states))
        if any("error" not in answer for _, answer in first):
            time.sleep(INTERVAL_S)
        second = list(pool.map(ask, states))
    return [_row(*each) for each in zip(states, first, second, strict=True)]


def _row(
    state: "ProcessState", first: tuple[float, dict[str, Any]], second: tuple[float, dict[str, Any]]
) -> dict[str, Any]:
    from eitskin_tools.console.run_status import Status
    from eitskin_tools.console.words import WITHHELD

    (before_s, before), (after_s, after) = first, second
    found: dict[str, Any] = {"name": state.skin.name, "control": state.skin.control, "well": False}
    if state.state:
        found |= {"state": state.state, "pid": state.pid, "restarts": state.restarts, "why": state.why}
    again = f", restarted {state.restarts} times, last because it {state.why}" if state.restarts else ""
    if "error" in after or "error" in before:
        return found | {"text": _unanswered(state) or str(after.get("error") or before.get("error"))}
    frames = int(after.get("frames", 0)) - int(before.get("frames", 0))
    rate_hz = max(frames, 0) / max(after_s - before_s, 1e-9)
    touched = after["touched"] > before["touched"] if "touched" in after and "touched" in before else None
    status, trouble = Status(rate_hz, touched, after), str(after.get("trouble") or "")
    why = WITHHELD.get(trouble, trouble) or "the device sends none"
    text = status.text() if frames > 0 else f"no usable frames: {why}"
    well = frames > 0 and not trouble
    return found | {"well": well, "text": text + again, "rate_hz": round(rate_hz, 1), "status": after}


def _unanswered(state: "ProcessState") -> str:
    """Return why a skin does not answer, from its supervisor; empty if it does not know."""
    if state.state in ("failed", "ended"):
        return f"{state.state}: {state.why}"
    if state.state == "waiting":
        return f"waiting: it {state.why}; its supervisor will restart it"
    if state.state == "starting" and state.restarts:
        return f"starting: it {state.why}, and its supervisor restarted it"
    return "starting: it is not ready yet" if state.state == "starting" else ""
