"""What reads a recording, each as its command does: by the name of the file, or all of them."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from . import samples
from .commanded import commanded


def _replay(path: Path) -> None:
    where = ["--publish", f"ipc://{path.parent}/f", "--control", f"ipc://{path.parent}/c"]
    commanded(path.parent, "replay", str(path), "--bundle", str(samples.TINY), "--as-fast-as-possible", *where)


def _play(path: Path) -> None:
    """Play it for somebody who takes all of it."""
    from tests.tools.recording.conftest import Taker

    from eitskin_tools.recording.replay.play import Manner, Player
    from eitskin_tools.recording.script import Script

    taker = Taker()
    with Player(Script(path), Manner(paced=False), bundle=samples.TINY) as player:
        for _ in player.skin.publish(taker):
            pass


def _reinfer(path: Path) -> None:
    out = ["--out", str(path.parent / "maps.npz"), "--quiet"]
    commanded(path.parent, "reinfer", str(path), "--bundle", str(samples.TINY), *out)


def _convert(path: Path) -> None:
    commanded(path.parent, "convert", str(path), "--out", str(path.parent / "out.npz"))


def _evaluate(path: Path) -> None:
    words = ("--solver", "tikhonov", "--bundle", str(samples.TINY))
    commanded(path.parent, "evaluate", "--measured", str(path), *words)


def _doctor(path: Path) -> None:
    commanded(path.parent, "doctor", "--electrodes", "--recorded", str(path))


def _view(path: Path) -> None:
    """Ask for the parts that a page would, and look over the whole of it."""
    from eitskin_tools.recording.layout import FRAME, WIRE
    from eitskin_tools.recording.reader import Recording
    from eitskin_tools.view.film.overview import Overview
    from eitskin_tools.view.film.parts import Film

    film = Film(path, samples.TINY)
    for number in sorted({0, 1, film.parts // 2, film.parts - 1}):
        if number < film.parts:
            film.part(number)
    overview = Overview(film.seconds, film.first_ns)
    for entry in Recording(path).entries({WIRE.topic, FRAME.topic}):
        overview.take(entry)
    overview.message(done=True)


READERS: Final[dict[str, Callable[[Path], None]]] = {
    "replay": _replay, "play": _play, "reinfer": _reinfer, "convert": _convert, "evaluate": _evaluate,
    "doctor": _doctor, "view": _view,
}  # fmt: skip


def read(path: Path) -> None:
    """Read a recording by what its name says, or in each way."""
    for name, reader in READERS.items():
        if path.stem in (name, "all"):
            reader(path)
