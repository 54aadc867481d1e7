"""The benchmark's tables, as Markdown."""

from typing import Any

Row = dict[str, Any]

UNITS = (
    "| touched units | maps | network exact | exact | wrong, unflagged | right, flagged | chi-squared | ms p50 / p95 |",
    "|---|---|---|---|---|---|---|---|",
)
ANYWHERE = (
    "| touches | maps | network CC, mm | CC mean / worst | mm median / rms | the data allow, mm | with the sheet known "
    "| right | wrong, unflagged | right, flagged | ms |",
    "|---|---|---|---|---|---|---|---|---|---|---|",
)


def units_line(row: Row) -> str:
    """Return a row of touched units."""
    return (
        f"| {row['what']} | {row['maps']} | {_percent(row['network_exact'])} | {_percent(row['exact'])} "
        f"| {_flags(row)} | {row['chi_squared_median']:.0f} | {_time(row)} |"
    )


def anywhere_line(row: Row) -> str:
    """Return a row of touches anywhere."""
    return (
        f"| {row['what']} | {row['maps']} | {row['network_cc']:.3f}, {_mm(row['network_localisation_median_mm'])} "
        f"| {row['cc']:.3f} / {row['cc_worst']:.3f} "
        f"| {_mm(row['localisation_median_mm'])} / {_mm(row['localisation_rms_mm'])} "
        f"| {_allowed(row, 'allowed')} | {_allowed(row, 'known')} | {_percent(row['right'])} "
        f"| {_flags(row)} | {row['cpu_ms_median']:.0f} / {row['cpu_ms_p95']:.0f} |"
    )


def tables(units: list[Row], anywhere: list[Row], stated: list[Row]) -> str:
    """Return all tables that have rows."""
    found = []
    if units:
        found.append([*UNITS, *map(units_line, units)])
    if anywhere:
        found.append([*ANYWHERE, *map(anywhere_line, anywhere)])
    if stated:
        lines = [f"| {one['what']} | {one['stated']:g} | {one['found']:.4f} | {one['error']:.4f} |" for one in stated]
        found.append(["| p | stated | found | +- |", "|---|---|---|---|", *lines])
    return "\n\n".join("\n".join(lines) for lines in found)


def _flags(row: Row) -> str:
    wrong, right = row["wrong"], row["maps"] - row["wrong"]
    return f"{row['wrong_unflagged']} of {wrong} | {row['right_flagged']} of {right}"


def _allowed(row: Row, sheet: str) -> str:
    """Return the median and rms that no estimate of centres without bias goes below."""
    return f"{_mm(row[f'{sheet}_median_mm'])} / {_mm(row[f'{sheet}_rms_mm'])}"


def _time(row: Row) -> str:
    return f"{row['cpu_ms_median']:.1f} / {row['cpu_ms_p95']:.1f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
