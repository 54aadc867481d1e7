"""What is said of noise, in bounds: NaN would get into every voltage."""

from typing import Final

from eitskin_tools.errors import UsageError

SNR_DB: Final = (0.0, 200.0)
"""As loud as the signal, and far below the last bit of any converter."""


def check_snr(value: float) -> None:
    """Refuse a ``--snr-db`` that no instrument has.

    Raises:
        UsageError: It is no number, or outside the bounds.
    """
    if not SNR_DB[0] <= value <= SNR_DB[1]:
        raise UsageError(f"--snr-db is {value:g}, expected {SNR_DB[0]:g} to {SNR_DB[1]:g}")


def check_seed(value: int) -> None:
    """Refuse a ``--seed`` that no generator takes.

    Raises:
        UsageError: It is negative.
    """
    if value < 0:
        raise UsageError(f"--seed is {value}, expected 0 or more")
