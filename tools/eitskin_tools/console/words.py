"""Values as people read them, not as Python writes them."""


def in_words(value: object) -> str:
    """Return a value on one line: ``none`` for nothing, ``yes`` or ``no``, texts of a list behind each other.

    Names of codes, such as ``ROLLED_BACK``, are in small letters. Numbers, and lists of them, are as a TOML file has
    them.
    """
    if value is None or value in ("", []):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list) and all(isinstance(one, str) for one in value):
        return "; ".join(one.lower().replace("_", " ") if one.isupper() else one for one in value)
    return str(value)
