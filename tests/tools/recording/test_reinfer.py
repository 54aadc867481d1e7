"""Recorded maps, computed once more: bit by bit what was published; of other solvers, how far they are from it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin import Frame, WireFrame
from eitskin.model.bundle import default_path, load_bundle
from eitskin_tools.recording.codec import digest_of
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.reinfer import (
    Agreement,
    ComputedFrame,
    Equality,
    centre_mm,
    comparison_solver,
    reinfer,
    unknown_clause,
    write,
)
from eitskin_tools.recording.script import Script, Step

from .conftest import TINY, measured, recorded


@pytest.mark.parametrize("options", [{}, {"solver": "tikhonov"}, {"budget_ms": 1000.0}, {"exclude": ()}])
def test_they_do_by_whatever_solver_and_options(tmp_path: Path, options: dict[str, Any]) -> None:
    recorded(tmp_path / "a.mcap", measured(90, **options))
    found = reinfer(Script(tmp_path / "a.mcap"), load_bundle(TINY)).fields()
    assert (found["equal"], found["differing"]) == (90, {})


def test_touched_frames_whose_map_nobody_asked_for_have_none_beside_another_solver_either(tmp_path: Path) -> None:
    def unasked(item: Any) -> Any:
        if not (isinstance(item, WireFrame) and item.touched):
            return item
        return replace(item, solver="none", map_seq=(item.seq or 0) - 1)

    recorded(tmp_path / "a.mcap", [unasked(item) for item in measured(90) if not isinstance(item, Frame)])
    script, bundle = Script(tmp_path / "a.mcap"), load_bundle(TINY)
    found = reinfer(script, bundle, comparison_solver(script, bundle, None, "tikhonov")).fields()["against_recorded"]
    assert (found["frames"], found["both_touched"]) == (90, 0)
    assert found["touched_agreement"] > 0.5


def test_means_of_a_touch_at_rest_come_out_the_same_and_are_not_guessed_without_their_frames(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", items := measured(330, skip_unchanged=True))  # the cloud comes amid the touch
    touched = [item for item in items if isinstance(item, Frame) and item.touched]
    assert {frame.fused for frame in touched} >= {1, 2, 4, 8, 16, 32}
    assert sum(frame.map_sequence == frame.sequence for frame in touched) < 20
    script, bundle = Script(tmp_path / "a.mcap"), load_bundle(TINY)
    found = reinfer(script, bundle).fields()
    assert (found["equal"], found["differing"]) == (330, {})
    amid_s = 1e-9 * (list(script.steps())[140].log_ns - script.first_ns)
    part = reinfer(script, bundle, from_s=amid_s).fields()
    assert part["unknown_why"].keys() == {"frame_missing"}
    assert part["differing"] == {}


def test_why_a_map_cannot_be_told_is_said_by_its_cause(file: Path) -> None:
    steps = [step.frame for step in Script(file).steps()]
    nothing, equality = np.zeros((30, 45), dtype=np.float32), Equality()
    first, seq = steps[0], steps[0].seq or 0

    def came(after: int, map_seq: int, found: ComputedFrame | None) -> None:
        frame = replace(first, seq=seq + after, map_seq=map_seq, solver="vd2t")
        equality.add(Step(frame, 0, published=b'{"digest": ""}'), found)

    touched = ComputedFrame(nothing, True, "vd2t")
    came(0, seq, None)
    came(1, seq - 5, None)
    came(2, seq - 5, touched)
    came(3, seq + 1, touched)
    came(4, seq + 3, touched)
    found = equality.fields()
    assert found["unknown_why"] == {"no_conditions": 2, "frame_missing": 3}
    assert found["unknown"] == 5
    said = unknown_clause(found)
    assert said.startswith("; 5 cannot be told: 2 came before the file has")
    assert unknown_clause(Equality().fields()) == ""


def test_the_same_solver_by_name_agrees_with_itself_and_another_does_less(file: Path) -> None:
    script, bundle = Script(file), load_bundle(TINY)
    ran = next(step.frame.solver for step in script.steps() if step.frame.touched)
    same = reinfer(script, bundle, comparison_solver(script, bundle, None, ran)).fields()["against_recorded"]
    assert same["touched_agreement"] == 1.0
    assert same["cc_p5"] == pytest.approx(1.0)
    other = reinfer(script, bundle, comparison_solver(script, bundle, None, "tikhonov")).fields()["against_recorded"]
    assert other["both_touched"] == same["both_touched"] > 10
    assert other["cc_median"] < 0.999


def test_another_bundle_is_compared_by_its_own_maps(short: Path) -> None:
    script, ran, named = Script(short), load_bundle(TINY), default_path()
    found = reinfer(script, ran, comparison_solver(script, ran, named, None), keep=1000)
    against = found.fields()["against_recorded"]
    assert against["frames"] == script.frames == 45
    assert against["both_touched"] > 10
    assert against["cc_p5"] <= against["cc_median"] < 0.999, "nothing else was computed"
    assert [digest_of(one.map) for _, one in found.others] == [step.note["digest"] for step in script.steps()]
    assert len({one.map.tobytes() for _, one in found.kept}) > 10


def test_another_bundle_asks_its_own_gate_and_not_the_recording(tmp_path: Path) -> None:
    items, ran = measured(45), load_bundle(TINY)
    touched = [item.touched for item in items if isinstance(item, WireFrame)]
    quiet = [replace(item, touched=False) if isinstance(item, WireFrame) else item for item in items]
    recorded(tmp_path / "a.mcap", quiet)
    script = Script(tmp_path / "a.mcap")
    found = reinfer(script, ran, comparison_solver(script, ran, default_path(), None), keep=1000)
    assert [one.touched for _, one in found.kept] == touched
    assert [one.touched for _, one in found.others] == [False] * 45
    assert found.fields()["against_recorded"]["touched_agreement"] == pytest.approx(1.0 - sum(touched) / 45)
    assert sum(touched) > 10


def test_one_frame_in_some_is_enough_for_a_slow_solver(file: Path) -> None:
    script, bundle = Script(file), load_bundle(TINY)
    found = reinfer(script, bundle, comparison_solver(script, bundle, None, "tikhonov"), every=10).fields()
    assert found["against_recorded"]["frames"] == 15


def test_one_frame_in_some_of_a_touch_at_rest_is_computed_by_itself(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", measured(330, skip_unchanged=True))
    script, bundle = Script(tmp_path / "a.mcap"), load_bundle(TINY)
    ran = next(step.frame.solver for step in script.steps() if step.frame.touched)
    found = reinfer(script, bundle, comparison_solver(script, bundle, None, ran), every=7).fields()
    assert found["against_recorded"]["both_touched"] > 10
    assert found["against_recorded"]["cc_p5"] > 0.9


def test_a_solver_that_is_not_there_is_named_with_those_that_are(file: Path) -> None:
    script, bundle = Script(file), load_bundle(TINY)
    with pytest.raises(
        ValueError, match=r"'sblx' does not exist; expected one of vd2t, vd2t-int8, .*tikhonov, verified"
    ):
        comparison_solver(script, bundle, None, "sblx")


def test_maps_are_written(file: Path, tmp_path: Path) -> None:
    script, bundle = Script(file), load_bundle(TINY)
    found = reinfer(script, bundle, comparison_solver(script, bundle, None, "tikhonov"), keep=1000, from_s=0.0)
    write(tmp_path / "maps.npz", found)
    with np.load(tmp_path / "maps.npz") as arrays:
        assert arrays["map"].shape == arrays["recorded_map"].shape == (150, 30, 45)
        assert arrays["seq"].tolist() == [step.frame.seq for step in script.steps()]


def test_more_maps_than_may_be_kept_are_refused(file: Path) -> None:
    with pytest.raises(RecordingError, match="--from and --to"):
        reinfer(Script(file), load_bundle(TINY), keep=10)


def test_without_digests_nothing_is_said_to_be_equal(tmp_path: Path, items: list[Any]) -> None:
    recorded(tmp_path / "a.mcap", [item for item in items if not isinstance(item, Frame)])
    found = reinfer(Script(tmp_path / "a.mcap"), load_bundle(TINY)).fields()
    assert "equal" not in found
    assert found["frames"] == sum(isinstance(item, WireFrame) for item in items)


def test_the_centre_of_a_disc_is_its_middle_and_moves_with_it() -> None:
    y, x = np.indices((30, 45)) + 0.5
    for middle in ((20.0, 10.0), (30.5, 22.25)):
        disc = (np.hypot(x - middle[0], y - middle[1]) < 4.0).astype(np.float32)
        found = centre_mm(disc, (2.0, 3.0))
        assert found is not None
        np.testing.assert_allclose(found, (2.0 * middle[0], 3.0 * middle[1]), atol=0.3)
    assert centre_mm(np.full((30, 45), 0.4, np.float32), (2.0, 3.0)) is None


def test_agreement_counts_touched_alike_and_measures_apart() -> None:
    one, other = np.zeros((30, 45), np.float32), np.zeros((30, 45), np.float32)
    one[5:8, 5:8] = other[5:8, 15:18] = 1.0
    found = Agreement((2.0, 2.0))
    found.add(ComputedFrame(one, True, "a"), ComputedFrame(other, True, "b"))
    found.add(ComputedFrame(one, True, "a"), ComputedFrame(np.zeros_like(one), False, "none"))
    fields = found.fields()
    assert fields["touched_agreement"] == 0.5
    assert fields["centre_mm_median"] == pytest.approx(20.0)
    assert fields["cc_median"] == pytest.approx(-9 / (1350 - 9))
