"""What a demonstration was like, for people."""

import sys
from typing import Any


def print_summary(summary: dict[str, Any]) -> None:
    """Print a summary for people."""
    latency, stages = summary["latency_us"], summary["stages_us"]

    def ms(value: float) -> str:
        return f"{value / 1000:.2f}"

    out = sys.stdout
    print(f"{summary['frames']} frames at {summary['rate_hz']:g} frames/s; {summary['lost']} lost, "
          f"{summary['corrupt']} corrupt", file=out)  # fmt: skip
    print(f"wire to subscriber: p50 {ms(latency['p50'])} ms, p99 {ms(latency['p99'])} ms, max {ms(latency['max'])} ms",
          file=out)  # fmt: skip
    if alone := summary["latency_inferred_us"]:
        print(f"  the {summary['inferred']} frames that a solver ran for: p50 {ms(alone['p50'])} ms, "
              f"p99 {ms(alone['p99'])} ms", file=out)  # fmt: skip
    parts = ", ".join(f"{name} {spans['p50']:.0f}/{spans['p99']:.0f}" for name, spans in stages.items() if spans)
    print(f"stages, us p50/p99: {parts}", file=out)
    if summary["cc_median"] is not None:
        split = [f"{name} {summary[key]:.3f}" for name, key in (("flat", "cc_median_flat"), ("bent", "cc_median_bent"))
                 if summary[key] is not None]  # fmt: skip
        print(f"correlation with the truth: median {summary['cc_median']:.3f} over {summary['scored']} touched frames "
              f"({', '.join(split)})", file=out)  # fmt: skip
    gate = [f"{name} {100 * summary[key]:.2f} %" for name, key in (("missed touches", "missed"),
            ("false alarms", "false_alarms")) if summary[key] is not None]  # fmt: skip
    print(f"touches: {summary['touches']}", file=out)
    print(f"gate: {', '.join(gate)}; clouds used: {summary['clouds']}", file=out)
