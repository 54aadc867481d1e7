"""``--seed`` of commands that train."""

from eitskin_tools.errors import UsageError


def check_seed(seed: int) -> None:
    """Refuse a seed from which training cannot draw.

    Raises:
        UsageError: It is below 0 or too large.
    """
    from eitskin_training.recipes import MOST_SEED

    if not 0 <= seed <= MOST_SEED:
        raise UsageError(f"--seed is {seed}; expected 0 to {MOST_SEED}")
