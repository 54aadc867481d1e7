"""A model with the material that a frame has shown: kept only where it explains that frame better."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import to_toml
from eitskin_sim.verification.units import UnitTouch
from eitskin_sim.verification.verdict import Fitted, Verdict
from eitskin_tools.verifier import checkers
from eitskin_tools.verifier.checkers import UnitChecker
from eitskin_tools.verifier.letters import FrameLetter, Setup, frame_letter

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))


def verdict(chi_squared: float, p_value: float, stretch: float) -> Verdict[UnitTouch]:
    shown = (Fitted("stretch", stretch, 0.001),)
    return Verdict((), chi_squared, 104, p_value, 0.01, 1, 0.0, shown)


@dataclass
class Scripted:
    """Answers as it is told."""

    answers: list[Verdict[UnitTouch]]
    asked: int = field(default=0)

    def verify(self, *_: object, **__: object) -> Verdict[UnitTouch]:
        self.asked += 1
        return self.answers[min(self.asked, len(self.answers)) - 1]


def checker_of(monkeypatch: pytest.MonkeyPatch, verifiers: Iterator[Scripted]) -> tuple[UnitChecker, list[object]]:
    """Return a checker whose verifiers come one after another, and the material that each was made with."""
    made: list[object] = []

    def prepared(*_: object, material: object = None) -> Scripted:
        made.append(material)
        return next(verifiers)

    monkeypatch.setattr(checkers, "prepared", prepared)
    setup = Setup(
        bundle="b", labels="units", touches="raising", skin=to_toml(SMALL), skin_digest=SMALL.digest, cloud=4,
        cloud_mm=SMALL.grid.flat_cloud_mm().astype("<f4").tobytes(), reference_V=np.ones(104).tobytes(),
        spread_V=np.full(104, 1e-3).tobytes(), budget_s=1.0,
    )  # fmt: skip
    return UnitChecker(setup), made


def frame() -> FrameLetter:
    nothing = np.zeros(104, dtype=np.bool_)
    values = np.zeros(12 * 18, dtype="f4")
    return FrameLetter.of(frame_letter(1, 9, 1000, 5, 6, 4, nothing, np.zeros(104, dtype="f4"), values))


@pytest.mark.parametrize(
    ("again", "kept"),
    [
        (verdict(900.0, 0.0, 0.0), False),
        (verdict(500.0, 0.0, 0.0), True),
        (verdict(1200.0, 0.2, 0.0), True),
        (verdict(5000.0, 0.0, 0.0), False),
    ],
)
def test_a_model_made_anew_is_kept_where_the_frame_that_asked_for_it_is_explained_better(
    monkeypatch: pytest.MonkeyPatch, again: Verdict[UnitTouch], kept: bool
) -> None:
    first, second = Scripted([verdict(1000.0, 0.0, 0.1)]), Scripted([again])
    checker, made = checker_of(monkeypatch, iter([first, second]))
    checker.check(frame())
    assert checker.improves
    checker.improve()
    assert made == [None, (pytest.approx(0.1), 0.0, 0.0)]
    assert (first.asked, second.asked) == (1, 1)
    checker.check(frame())
    assert (first.asked, second.asked) == ((1, 2) if kept else (2, 1))


def test_frames_that_are_not_understood_ask_four_times_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    nonsense = verdict(1000.0, 0.0, 0.1)
    checker, made = checker_of(monkeypatch, (Scripted([nonsense]) for _ in range(99)))
    for _ in range(9):
        checker.check(frame())
        if checker.improves:
            checker.improve()
    assert len(made) == 1 + checkers.TRIED


def test_what_is_found_is_added_to_what_the_model_has(monkeypatch: pytest.MonkeyPatch) -> None:
    better = [verdict(1000.0, 0.0, 0.1)], [verdict(500.0, 0.0, 0.05)], [verdict(90.0, 0.8, 0.03)]
    checker, made = checker_of(monkeypatch, (Scripted(answers) for answers in better))
    for _ in range(3):
        checker.check(frame())
        if checker.improves:
            checker.improve()
    assert made[1:] == [(pytest.approx(0.1), 0.0, 0.0), (pytest.approx(0.15), 0.0, 0.0)]
    assert not checker.improves


def test_nothing_is_made_that_no_frame_has_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    checker, made = checker_of(monkeypatch, iter([Scripted([verdict(90.0, 0.8, 0.01)])]))
    checker.improve()
    checker.check(frame())
    assert not checker.improves
    checker.improve()
    assert made == [None]
