"""What the process of one skin is started with: the words of ``eitskin run``, from its part of robot.toml."""

from eitskin.robot.config import SkinSettings


def words_of(settings: SkinSettings) -> list[str]:
    """Return the command line of a skin, without the program."""
    found = ["run", f"--port={settings.port}", "--log-format=json"]
    found += [f"--publish={settings.skin.publish}", f"--control={settings.skin.control}"]
    valued = {
        "baud": settings.baud,
        "reconnect": settings.reconnect_s,
        "bundle": settings.bundle,
        "touches": settings.touches,
        "skin": settings.description,
        "curve-keys": settings.curve_keys,
        "reference": settings.reference,
        "reference-frames": settings.reference_frames,
        "budget-ms": settings.budget_ms,
        "solver": settings.solver,
        "idle-after": settings.idle_after_s,
        "sched-fifo": settings.realtime.sched_fifo,
        "affinity": ",".join(map(str, settings.realtime.affinity)) or None,
        "verify": None if settings.verify.mode == "off" else settings.verify.mode,
        "verify-budget-ms": settings.verify.budget_ms,
        "verify-nice": settings.verify.nice,
        "verify-affinity": ",".join(map(str, settings.verify.affinity)) or None,
    }
    found += [f"--{name}={value}" for name, value in valued.items() if value is not None]
    found += [f"--exclude-electrode={number}" for number in settings.exclude_electrodes]
    truths = {"every-map": settings.every_map, "mlock": settings.realtime.mlock}
    found += [f"--{name}" for name, value in truths.items() if value]
    if settings.compensate_drift is not None:
        found.append("--compensate-drift" if settings.compensate_drift else "--no-compensate-drift")
    return found
