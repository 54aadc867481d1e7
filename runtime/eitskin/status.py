"""What a skin says of itself: counters of its stream and the ids of what it runs with."""

from typing import Any

from eitskin.acquisition.device import Device
from eitskin.frame_loop import FrameLoop
from eitskin.messaging.regions import whole
from eitskin.pipeline.frame_pipeline import Pipeline


def status_of(device: Device, pipeline: Pipeline, loop: FrameLoop) -> dict[str, Any]:
    """Return counters and ids; may be called from any thread.

    Args:
        device: The skin's.
        pipeline: The skin's.
        loop: Between the two.
    """
    record, intake, found, health = pipeline.record, pipeline.intake, loop.reference, pipeline.health
    return {
        "frames": loop.statistics.frames,
        "published": loop.published,
        "touched": loop.statistics.touched,
        "lost": intake.counter.lost,
        "corrupt": device.deframer.corrupt,
        "withheld": intake.withheld_total,
        "withheld_by_reason": dict(intake.withheld),
        "resets": intake.counter.resets,
        "recoveries": loop.source.recoveries,
        "trouble": loop.source.trouble,
        "overruns": pipeline.budget.overruns,
        "level": pipeline.budget.level,
        "cloud": record.cloud,
        "idle": record.idle,
        "mode_changes": 0 if loop.idle is None else loop.idle.switches,
        "regions": [list(region.bounds) for region in whole(pipeline.skin.grid.shape)],
        "clock_drift_ppm": round(intake.clock.drift_ppm, 3),
        "wire_delay_us": intake.clock.shortest_delay_us,
        "serial_number": device.hello.serial_number,
        "configuration": device.configuration,
        "bundle": pipeline.bundle.id,
        "skin": f"{pipeline.skin.name}/{pipeline.skin.digest}",
        "reference_utc": found.captured_utc if found else "",
        "weak_rows": found.weak.tolist() if found else [],
        "electrodes": [] if health is None else list(health.electrodes.texts),
        "drift": {} if health is None else health.drift.summary(),
        "verifier": loop.verifier_status(),
    }
