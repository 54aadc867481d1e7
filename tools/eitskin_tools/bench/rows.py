"""A benchmark's row as people read it."""

from collections.abc import Mapping


def row_text(row: Mapping[str, object]) -> str:
    """Return names and values in a line; what was measured stands in front, if the row says ``what``.

    Args:
        row: One row, or a summary.
    """
    figures = "  ".join(f"{name} {value}" for name, value in row.items() if name != "what")
    return f"{row['what']}:  {figures}" if "what" in row else figures
