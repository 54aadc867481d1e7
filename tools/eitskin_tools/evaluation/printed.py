"""The output of ``eitskin evaluate`` for people."""

import json
from typing import Any, Final

from eitskin_proto.files.plain import plain

PAPER_CC: Final = {
    "tikhonov": (0.5967, 0.7198, 0.6387, 0.6565, 0.7641, 0.6659, 0.7036, 0.5551),
    "l1": (0.5755, 0.6080, 0.6700, 0.6484, 0.7118, 0.7010, 0.7395, 0.6665),
    "sbl": (0.6877, 0.7110, 0.7408, 0.8132, 0.8020, 0.7085, 0.8152, 0.6549),
    "vd2t": (0.9976, 0.9762, 0.9957, 0.9999, 0.9987, 0.9660, 0.9974, 0.9981),
}
"""The paper's Table II: correlation by algorithm, of phantoms 1 to 8."""


def print_report(found: dict[str, Any]) -> None:
    """Print the verdict, and the scores of phantoms beside the paper's where they are the paper's."""
    besides = " and V_pred" if found["prediction"] == "scan" else ""
    paper = PAPER_CC.get(found["solver"].split("-")[0]) if len(found["phantoms"]) == len(PAPER_CC["vd2t"]) else None
    mean, count = found["mean"], len(found["phantoms"])
    verdict = f"{found['solver']}: all touches right in {mean['exact']:.0%} of the maps of {count} phantoms"
    verdict += "" if mean["cc"] is None else f", mean CC {mean['cc']:.3f}"
    print(verdict + (f" (the paper: {sum(paper) / len(paper):.3f})" if paper else ""))
    print(f"{found['noise']} at {found['snr_db']:g} dB, reference: {found['reference']}{besides}\n")
    print(
        "phantom      CC  PSNR dB      RIE  localisation mm  exact  touches  of  two-point mm      DE"
        + ("  paper's CC" if paper else "")
        + ("       p  flagged" if "verified" in found else "")
    )
    rows = [*found["phantoms"], {"name": "mean", **found["mean"]}]
    papers = [*paper, sum(paper) / len(paper)] if paper else [None] * len(rows)
    for row, theirs in zip(rows, papers, strict=True):
        line = f"{plain(row['name']):8}{cell(row['cc'], 7, '.4f')}{row['psnr_db']:9.2f}{cell(row['rie'], 9, '.4f')}"
        line += f"{row['localisation_mm']:17.2f}{row['exact']:7.2f}{row['touches']:9.1f}{row['true_touches']:4.1f}"
        line += f"{cell(row['two_point_mm'], 14, '.1f')}{cell(row['distance_error'], 8, '.4f')}"
        line += "" if theirs is None else f"{theirs:12.4f}"
        line += f"{row['p_value']:8.2g}{row['flagged']:9.2f}" if "p_value" in row else ""
        print(line)
    if (verified := found.get("verified")) is not None:
        print(
            f"verified: {verified['maps']} maps; {verified['wrong']} wrong, {verified['wrong_unflagged']} of them not "
            f"flagged; {verified['right_flagged']} right ones flagged; {verified['extra_ms_median']:.1f} ms a frame"
        )


def cell(value: float | None, width: int, form: str) -> str:
    """Return a number of some width, in the form of ``format``; a dash where there is none."""
    return f"{'-':>{width}}" if value is None else f"{value:{width}{form}}"


def print_trial(found: dict[str, Any], as_json: bool) -> int:
    """Print what a trial gave, as an object or the verdict before a table, and return 0."""
    if as_json:
        print(json.dumps(found))
        return 0
    trial, intervals = found["trial"], found.get("interval_95", {})
    print(f"{found['solver']}: {_verdict(found)}")
    print(
        f"{trial['kind']}, {trial['n_deformations']} deformations of family {trial['family']}, {trial['each']} maps at "
        f"each, seed {trial['seed']}; {found['noise']} at {found['snr_db']:g} dB, cloud: {found['cloud']}, "
        f"reference: {found['reference']}\n"
    )
    for name, value in found.items():
        if isinstance(value, int | float):
            low_high = intervals.get(name)
            between = (
                f"  95 % of draws: {low_high[0]:.4f} to {low_high[1]:.4f}"
                if low_high and low_high[0] < low_high[1]
                else ""
            )
            print(f"{name:24} {value:10.4f}{between}" if isinstance(value, float) else f"{name:24} {value:>10}")
    for name, value in found.get("verified", {}).items():
        print(f"verified {name:15} {value:>10}" if isinstance(value, int) else f"verified {name:15} {value:10.4f}")
    if intervals:
        print("\nIntervals are clustered: whole deformations are drawn again, 2,000 times.")
    return 0


def _verdict(found: dict[str, Any]) -> str:
    """Return what a trial says, in one sentence."""
    maps = found["maps"]
    if "peak" in found:
        return f"{found['ghost_share']:.1%} of {maps} untouched maps show a touch; highest pixel {found['peak']:.2f}"
    cc = "no CC" if found["cc"] is None else f"CC {found['cc']:.3f}"
    return (
        f"{cc}, touches {found['localisation_rms_mm']:.2f} mm off (rms) and {found['missed']:.1%} missed, "
        f"in {maps} maps"
    )
