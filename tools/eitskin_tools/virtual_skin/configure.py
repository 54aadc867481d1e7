"""The configuration that the virtual skin is built with: the paper's, made faster where the rate asks for it."""

from dataclasses import replace

from eitskin_proto.wire import config_toml
from eitskin_proto.wire.config import Configuration


def configuration_for(rate_hz: float, name: str = "paper") -> Configuration:
    """Return a named configuration at a rate, with less settling and averaging where its own are too slow for it.

    Args:
        rate_hz: Frames a second.
        name: Of a shipped configuration, or the path of a TOML file.

    Raises:
        ValueError: The electronics cannot reach the rate; the largest is given.
    """
    asked = replace(config_toml.load(name), rate_mHz=round(rate_hz * 1000))
    quick = replace(asked, frequency_hz=100_000, averages=1, settle_us=20)
    for candidate in (asked, replace(asked, frequency_hz=50_000, averages=4, settle_us=40), quick):
        if 1e9 / candidate.scan_us() >= candidate.rate_mHz:
            return candidate
    raise ValueError(f"a rate of {rate_hz:g} Hz is too high: the electronics reach {int(1e6 / quick.scan_us())} Hz")
