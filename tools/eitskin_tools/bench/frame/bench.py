"""``eitskin bench frame``: from the wire to the subscriber, paced, and other ways to infer the same map.

Two measurements in one run. The stream: virtual skin, runtime and subscriber as processes, at 200 and at 1000
frames/s; before and behind each, the same line and socket with nothing done in between
(:mod:`eitskin_tools.bench.frame.line_floor`), which is what this machine takes for itself. The inference: every variant
of :mod:`eitskin_tools.bench.frame.variants`, interleaved, one call a 5 ms period (what a robot sees: caches and clocks
have cooled) and back to back (warm). Percentiles, never means; nothing is repeated until it looks good.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any, Final

from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError

RATES_HZ: Final = (200.0, 1000.0)
"""Paced rates; the first one is the summary's."""

PERIOD_S: Final = 0.005
"""Between two paced calls."""

WARM_CALLS: Final = 30
"""Calls of one variant back to back, before the next has its turn."""

MOST_STREAMS: Final = 16
"""Subscribers to what was measured."""

LINE_FRAMES: Final = 1000
"""Most frames of the bare line, before a stream and behind it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=20_000, metavar="N", help="frames at each rate (default 20000)")
    parser.add_argument("--calls", type=int, default=500, metavar="N", help="paced calls of each variant (default 500)")
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to run (default: the shipped one)")
    parser.add_argument("--rate", type=float, action="append", metavar="HZ", help="instead of 200 and 1000; repeatable")
    parser.add_argument("--solver", metavar="NAME", help="most accurate solver of the stream, as for 'eitskin run'")
    parser.add_argument("--core", type=int, metavar="CPU", help="run the runtime, all its threads, on this CPU only")
    parser.add_argument("--streams", type=int, default=0, metavar="N", help="with N subscribers to what was measured")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if not 0 <= arguments.streams <= MOST_STREAMS:
        raise UsageError(f"--streams is {arguments.streams}, expected 0 to {MOST_STREAMS}")
    if arguments.frames < 100 or arguments.calls < 10:
        raise UsageError("--frames must be at least 100 and --calls at least 10: percentiles need values")
    available = os.sched_getaffinity(0)
    if arguments.core is not None and arguments.core not in available:
        raise UsageError(f"--core {arguments.core} is not one of this process's CPUs: {sorted(available)}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rates = arguments.rate or RATES_HZ
    streams = {
        f"{rate:g}": stream(
            rate, arguments.frames, arguments.bundle, core=arguments.core, solver=arguments.solver,
            streams=arguments.streams,
        )
        for rate in rates
    }  # fmt: skip
    first = next(iter(streams.values()))
    found = {**first, "streams": streams, **inference(arguments.bundle, arguments.calls), "machine": machine()}
    if arguments.json:
        print(json.dumps(found))
    else:
        _print(found)
    return 0


def stream(
    rate_hz: float,
    frames: int,
    bundle: Path | None,
    *,
    core: int | None = None,
    solver: str | None = None,
    streams: int = 0,
) -> dict[str, Any]:
    """Return the timing of a stream of so many frames at one rate, and of the bare line around it.

    Args:
        rate_hz: Frames a second.
        frames: How many.
        bundle: To run; None for the shipped one.
        core: CPU that the runtime, or the bare line's relay, runs on; None for any.
        solver: The most accurate one to use; None for the bundle's own choice.
        streams: Subscribers to what was measured, beside the one to frames.
    """
    import numpy as np

    from eitskin_tools.bench.frame.line_floor import floor_ns
    from eitskin_tools.demo.score import percentiles_us, timing
    from eitskin_tools.demo.show import Options
    from eitskin_tools.demo.show import stream as streamed

    print(f"eitskin bench frame: {frames} frames at {rate_hz:g} frames/s", file=sys.stderr)
    bare = [floor_ns(rate_hz, min(frames, LINE_FRAMES), core)]
    seconds = frames / rate_hz
    result = streamed(Options(seconds, rate_hz, bundle, solver, clouds=False, affinity=core, streams=streams))
    bare.append(floor_ns(rate_hz, min(frames, LINE_FRAMES), core))
    names = ("cpu_us_per_frame", "behind_us", "left_us", "skipped", "solvers", "withheld")
    runtime = {name: result.runtime.get(name) for name in names}
    found = timing(result.record, result.wire_ns)
    line = percentiles_us(np.concatenate(bare))
    over = {name: round(found["latency_us"][name] - line[name], 1) for name in ("p50", "p99")}
    return {**found, "runtime": runtime, "core": core, "line_us": line, "over_line_us": over}


def inference(path: Path | None, calls: int) -> dict[str, Any]:
    """Return the time of every variant and how many times slower than ours it is.

    Args:
        path: Of the bundle; None for the shipped one.
        calls: Paced calls of each variant.
    """
    import numpy as np

    from eitskin.model.bundle import load_bundle
    from eitskin_tools.bench.frame.variants import FLOORS, streamed_bytes, variants
    from eitskin_tools.demo.score import percentiles_us

    bundle = load_bundle(path)
    ways, missing = variants(bundle)
    print(f"eitskin bench frame: {', '.join(ways)}, {calls} paced calls each", file=sys.stderr)
    clock, spent = time.perf_counter_ns, time.process_time_ns
    paced: dict[str, list[int]] = {name: [] for name in ways}
    warm: dict[str, list[int]] = {name: [] for name in ways}
    cpu: dict[str, list[int]] = {name: [] for name in ways}
    for infer in ways.values():
        infer()
    due = time.perf_counter()
    for _ in range(calls):
        for name, infer in ways.items():
            due = max(due + PERIOD_S, time.perf_counter())
            time.sleep(max(due - time.perf_counter(), 0.0))
            start = clock()
            infer()
            paced[name].append(clock() - start)
    for _ in range(max(calls // WARM_CALLS, 1)):
        for name, infer in ways.items():
            for call in range(WARM_CALLS):
                before, start = spent(), clock()
                infer()
                end, after = clock(), spent()
                if call >= WARM_CALLS // 3:  # the first calls bring the weights back into the caches
                    warm[name].append(end - start)
                    cpu[name].append(after - before)
    times = {
        name: {
            "paced": percentiles_us(np.array(paced[name])),
            "warm": percentiles_us(np.array(warm[name])),
            "warm_cpu": percentiles_us(np.array(cpu[name])),
        }
        for name in ways
    }
    ours = next(iter(ways))
    return {
        "ours": ours,
        "inference_us": times,
        "ratios": {name: round(times[name]["paced"]["p50"] / times[ours]["paced"]["p50"], 2) for name in ways},
        "ratios_warm": {name: round(times[name]["warm"]["p50"] / times[ours]["warm"]["p50"], 2) for name in ways},
        "head_bytes": streamed_bytes(bundle),
        "floor_share": {
            solver: {how: round(times[floor][how]["p50"] / times[solver][how]["p50"], 3) for how in ("paced", "warm")}
            for floor, solver in FLOORS.items()
            if floor in times
        },
        "torch_over_int8_warm": _ratio(times, "torch-eager", "vd2t-int8", "warm"),
        "torch_over_int8_cpu": _ratio(times, "torch-eager", "vd2t-int8", "warm_cpu"),
        "missing": missing,
        "bundle": bundle.id,
    }


def _ratio(times: dict[str, Any], slow: str, fast: str, how: str) -> float | None:
    """Return how many times longer one variant takes than another; None if either is missing.

    By the clock a busy machine interrupts the longer of two more often; by CPU time it does not matter.
    """
    if slow not in times or fast not in times:
        return None
    return round(float(times[slow][how]["p50"]) / float(times[fast][how]["p50"]), 1)


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    import platform

    model = "unknown"
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    load = os.getloadavg()[0]
    return {"cpu": model, "cores": os.cpu_count(), "load_1min": round(load, 2), "python": platform.python_version()}


def _print(found: dict[str, Any]) -> None:
    for rate, result in found["streams"].items():
        latency = "  ".join(f"{name} {value:.0f}" for name, value in result["latency_us"].items())
        stages = ", ".join(f"{name} {us['p50']:.0f}/{us['p99']:.0f}" for name, us in result["stages_us"].items() if us)
        print(f"{rate} frames/s, {result['frames']} frames, {result['lost']} lost; wire to subscriber, us: {latency}")
        alone = "  ".join(f"{name} {value:.0f}" for name, value in result["latency_inferred_us"].items())
        print(f"  the {result['inferred']} that a solver ran for (the others untouched or unchanged), us: {alone}")
        line = "  ".join(f"{name} {value:.0f}" for name, value in result["line_us"].items())
        print(f"  the bare line and socket, us: {line}; beyond it p50 {result['over_line_us']['p50']:.0f}")
        print(f"  stages, us p50/p99: {stages}")
        behind, left = (result["runtime"][name] for name in ("behind_us", "left_us"))
        told, rest = (f"{behind[name]['p50']:.0f}/{behind[name]['p99']:.0f}" for name in ("streams", "rest"))
        print(f"  behind publishing, us p50/p99: streams {told}, rest {rest}; left before the next frame: "
              f"p50 {left['p50']:.0f}, p1 {left['p1']:.0f}")  # fmt: skip
        print(f"  CPU of the runtime, us a frame: {result['runtime']['cpu_us_per_frame']}")
    print(f"{'inference, us':24}{'paced p50':>10}{'p99':>9}{'warm p50':>10}{'its CPU':>9}{'times ours':>12}")
    for name, times in found["inference_us"].items():
        print(f"{name:24}{times['paced']['p50']:10.0f}{times['paced']['p99']:9.0f}{times['warm']['p50']:10.0f}"
              f"{times['warm_cpu']['p50']:9.0f}{found['ratios'][name]:12.2f}")  # fmt: skip
    if found["torch_over_int8_cpu"] is not None:
        clock, cpu = found["torch_over_int8_warm"], found["torch_over_int8_cpu"]
        print(f"torch eager takes {clock} times as long as the int8 head, warm; {cpu} times the CPU")
    for solver, share in found["floor_share"].items():
        print(
            f"{solver}: the memory-bandwidth floor is {share['paced']:.2f} of its time paced, {share['warm']:.2f} warm"
        )
    for name, reason in found["missing"].items():
        print(f"{name} was left out: {reason}")
    print(f"on {found['machine']['cpu']}, {found['machine']['cores']} cores, load {found['machine']['load_1min']}")
