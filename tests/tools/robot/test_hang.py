"""A skin's process whose frame loop stands still in C code ends and is started again, and nobody else is."""

import pytest

from .conftest import gone


@pytest.mark.process
def test_one_whose_c_code_keeps_the_interpreter_is_ended_and_started_again(family, tmp_path):
    with family("on-failure", hang_s=1.0, a="hangs", b="good", c="starts") as found:
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "a")
        before = found.states()
        (tmp_path / "hang").touch()
        error = found.until(lambda event: event["event"] == "error")
        assert error["skin"] == "a"
        assert "ended with status 1" in error["text"]
        assert "starts again in 0.05 s" in error["text"]
        shown = [event["text"] for event in found.heard if event["event"] == "warning"]
        assert any(line.startswith("Timeout") for line in shown), shown
        assert any("skin_script.py" in line and line.endswith("in hang") for line in shown), shown
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "a")
        now = found.states()
        assert (now["a"].state, now["a"].restarts) == ("ready", 1)
        assert gone(before["a"].pid)
        assert (now["b"].pid, now["c"].pid) == (before["b"].pid, before["c"].pid)  # one lives, one only starts
        assert (now["b"].restarts, now["c"].restarts) == (0, 0)
