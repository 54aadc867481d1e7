"""What ``eitskin evaluate`` prints for people."""

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
    """Print the scores of phantoms, beside the paper's where they are the paper's."""
    besides = {"scan": " and V_pred", "true": " and the true untouched voltages"}.get(found["prediction"], "")
    print(f"{found['solver']}, {found['noise']} at {found['snr_db']:g} dB, reference: {found['reference']}{besides}")
    paper = PAPER_CC.get(found["solver"].split("-")[0]) if len(found["phantoms"]) == len(PAPER_CC["vd2t"]) else None
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
    """Print what a trial gave, as an object or a line each, and return 0."""
    if as_json:
        print(json.dumps(found))
        return 0
    for name, value in found.items():
        if name != "deformations":
            print(f"{name:24} {_text(value)}")
    return 0


def _text(value: Any) -> str:
    """Return a value as people read it: what is not there is a dash, and nothing stands in brackets."""
    if isinstance(value, float):
        return f"{value:.4f}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {one}" for key, one in value.items())
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "-"
    return "-" if value is None else str(value)
