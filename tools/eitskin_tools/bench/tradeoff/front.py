"""Which variants nothing beats in both, and the table that says so."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

GATE: Final = "gate alone"
"""Judges and gives no map; its error is of another kind."""


def mark_front(rows: Sequence[dict[str, Any]]) -> None:
    """Say of each row in ``pareto`` whether nothing that gives a whole map beats it in both."""
    for row in rows:
        row["pareto"] = not row["variant"].startswith(GATE) and not _beaten(row, rows)


def _beaten(row: dict[str, Any], rows: Sequence[dict[str, Any]]) -> bool:
    """Return whether another variant, one that gives a whole map, is as good in both and not the same."""
    return any(
        other["whole"] and other["error"] <= row["error"] and other["p50"] <= row["p50"] and other is not row
        for other in rows
    )


def flat_rows(panels: Mapping[str, Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Return the rows of all panels in one list, each with its panel's name."""
    return [{"panel": name, **row} for name, rows in panels.items() for row in rows]


def summary(panels: Mapping[str, Sequence[dict[str, Any]]]) -> dict[str, Any]:
    """Return, by panel, what gives the most accurate whole map, and what is on the front."""
    return {
        name: {
            "most_accurate": min((row for row in rows if row["whole"]), key=lambda row: row["error"])["variant"],
            "on_front": [row["variant"] for row in rows if row["pareto"]],
        }
        for name, rows in panels.items()
    }


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table, the most accurate first."""
    lines = ["| variant | 1 - CC | p50, us | p99, us | on the front |", "|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: row["error"]):
        front = ("yes" if row["whole"] else "yes, for its part") if row["pareto"] else ""
        lines.append(f"| {row['variant']} | {row['error']:.4f} | {row['p50']:.0f} | {row['p99']:.0f} | {front} |")
    return "\n".join(lines)
