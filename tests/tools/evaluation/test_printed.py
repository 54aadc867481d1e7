"""What ``eitskin evaluate`` prints of phantoms."""

from eitskin_tools.evaluation.printed import print_report

SCORES = {
    "cc": 1.0, "psnr_db": 120.0, "rie": 0.0, "localisation_mm": 0.0, "exact": 1.0, "touches": 1, "true_touches": 1,
    "two_point_mm": None, "distance_error": None,
}  # fmt: skip
REPORT = {"prediction": "scan", "solver": "verified", "noise": "N2", "snr_db": 50.0, "reference": "pre", "mean": SCORES}


def test_a_verified_phantom_has_its_p_beside_its_scores_and_all_have_a_line(capsys):
    one = {"name": "1", **SCORES, "p_value": 0.00321, "flagged": 1.0, "extra_ms": 4.0}
    sums = {"maps": 1, "wrong": 0, "wrong_unflagged": 0, "right_flagged": 1, "extra_ms_median": 4.0}
    print_report({**REPORT, "phantoms": [one], "verified": sums})
    _, head, row, mean, last = capsys.readouterr().out.splitlines()
    assert head.endswith("DE       p  flagged")
    assert row.endswith("  0.0032     1.00")
    assert len(row) == len(head)
    assert len(mean) < len(row), "a p of all phantoms means nothing"
    assert last == "verified: 1 maps; 0 wrong, 0 of them not flagged; 1 right ones flagged; 4.0 ms a frame"


def test_a_name_forges_no_line_and_moves_no_cursor(capsys):
    print_report({**REPORT, "solver": "vd2t", "phantoms": [{"name": "\x1b[2J\n\ud800", **SCORES}]})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[2].startswith(r"\x1b[2J\x0a\ud800")
