"""What ``eitskin run`` says once it has everything, and when it ends."""

from typing import TYPE_CHECKING, Any

from eitskin_tools.console.run_log import RunLog

if TYPE_CHECKING:
    from eitskin.model.bundle import Bundle
    from eitskin_proto.skin.skin import Skin


def report(skin: Any, log: RunLog) -> None:
    """Say what was got, line by line: device, bundle, skin, gate."""
    from eitskin_proto.skin.skin import PAPER

    hello = skin.device.hello
    for line in skin.transport.report():
        log.say(line)
    version = ".".join(map(str, hello.firmware_version))
    log.say(
        f"device: {hello.serial_number}, firmware {version}, protocol {hello.protocol_major}.{hello.protocol_minor}, "
        f"configuration {skin.device.configuration}, {hello.rate_mHz / 1000:g} frames/s of {hello.rows} rows"
    )
    solvers = ", ".join(f"{name} {span / 1000:.0f} us" for name, span in skin.pipeline.maps.engine_ns.items())
    bundle = skin.bundle
    log.say(f"bundle: {bundle.path.name} {bundle.id}, {bundle.labels} labels, {bundle.touch_kind} touches; {solvers}")
    rows, columns = skin.description.grid.shape
    log.say(f"skin: {skin.description.name} {skin.description.digest}, map of {rows} x {columns} pixels")
    for line in doubts(bundle, skin.description):
        log.warn(line)
    if not hello.skin_digest and skin.description.grid_id != PAPER.grid_id:
        log.warn(
            f'the device does not say which skin it is wired to: state skin = "{skin.description.grid_id}" in its '
            "configuration, and 'eitskin flash write'"
        )
    gate = skin.bundle.manifest.get("gate") or {}
    rate = gate.get("false_alarm_rate")
    stated = f"{rate:.2%}" if isinstance(rate, float) else "unknown"
    log.say(f"gate: false-alarm rate {stated}" if gate else "gate: none in this bundle")


def doubts(bundle: "Bundle", description: "Skin") -> list[str]:
    """Return what is odd about a skin in use and its bundle, and stops nobody."""
    from eitskin_proto.skin.touch_kind import knows

    touches = description.touch_kind
    if description is bundle.skin or knows(bundle.touch_kind, touches):
        return []
    return [f"{description.name} has {touches} touches, the bundle knows {bundle.touch_kind} ones: see --touches"]


def closing(summary: dict[str, Any]) -> str:
    """Return the line that a run ends with."""
    latency = summary["latency_us"]
    return (
        f"{summary['frames']} frames at {summary['rate_hz']:.1f}/s, {summary['lost']} lost, "
        f"{summary['corrupt']} corrupt, {summary['withheld']} withheld, read to publish {latency['p50']:.0f} us p50, "
        f"{latency['p99']:.0f} p99, {latency['max']:.0f} max"
    )
