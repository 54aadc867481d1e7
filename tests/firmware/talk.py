"""Talking to the C device in memory: requests in, what it said out, time passes by hand."""

from eitskin_proto.wire import config_toml, framing, messages

PAPER = config_toml.named("paper")
FAST = config_toml.named("fast")


def talk(device, *requests, run_us=1000):
    """Send requests, let time pass, and return what the device said."""
    device.write(b"\0" + b"".join(framing.encode(request.pack()) for request in requests))
    said = b""
    for _ in range(0, run_us, 100_000):
        device.run(min(run_us, 100_000))
        said += device.take()
    return [messages.unpack(payload) for payload in framing.Deframer().feed(said)]


def ack(device, request, **kwargs):
    [answer] = [m for m in talk(device, request, **kwargs) if isinstance(m, messages.Ack)]
    assert (answer.request, answer.tag) == (request.LAYOUT.type, request.tag)
    return answer


def begin(token=5, **changes):
    fields = {"size": 64, "digest": FAST.digest, "hardware_id": FAST.hardware_id, "revision": FAST.revision,
              "name": FAST.name, "format": 1}  # fmt: skip
    return messages.ConfigBegin(**{"tag": 9, "token": token, **fields, **changes})
