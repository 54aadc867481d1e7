"""Everything that ``eitskin view FILE.mcap`` runs, as one context."""

from typing import Self

from eitskin.robot.pose import Pose
from eitskin_tools.view.film.overview import Overlooking, Overview
from eitskin_tools.view.film.parts import PART_S, Film
from eitskin_tools.view.messages import skin_message, status_message
from eitskin_tools.view.served import Served


class Projector(Served):
    """Serves the page of a recording.

    Args:
        film: The recording.
        host: Address to serve on.
        port: 0 for any that is free.
        token: What a page must know; empty only on loopback.

    Raises:
        PortTaken: The address cannot be bound.
        ValueError: It can be reached from other machines, and there is no token.
    """

    def __init__(self, film: Film, *, host: str = "127.0.0.1", port: int = 0, token: str = "") -> None:
        super().__init__()
        self._film = film
        about = {
            "name": "", "skins": 1, "file": film.path.name, "seconds": film.seconds, "parts": film.parts,
            "part_s": PART_S, "begin_ms": film.first_ns / 1e6,
        }  # fmt: skip
        self.board.post("skin", skin_message(film.skin, 0, Pose(), about))
        self.board.post("status", status_message("live", film.ending))
        self.serve(host, port, token, film=film)

    def __enter__(self) -> Self:
        overview = Overview(self._film.seconds, self._film.first_ns)
        self.stack.enter_context(
            Overlooking(self._film.path, overview, lambda message: self.board.post("overview", message))
        )
        return super().__enter__()
