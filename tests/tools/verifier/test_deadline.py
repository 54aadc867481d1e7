"""What a computation takes is counted in time that it had; what is far beyond it hangs."""

import threading

from eitskin_tools.verifier.process import MAX_COUNTED_S, Deadline, ThreadTime

from .conftest import until


def test_only_what_is_beyond_what_it_may_take_is_late():
    deadline = Deadline(lambda: 1.0)
    assert deadline.late_s() == 0.0  # at nothing
    with deadline.within(2.0):
        assert [deadline.late_s() for _ in range(4)] == [0.0, 0.0, 1.0, 2.0]
    assert deadline.late_s() == 0.0
    with deadline.within(0.5):
        assert deadline.late_s() == 0.5  # counted anew


def test_a_thread_that_sleeps_has_time_and_one_that_waits_for_a_core_has_none(tmp_path):
    wakes = threading.Event()
    thread = threading.Thread(target=wakes.wait)
    thread.start()
    try:
        had = ThreadTime(thread)
        until(lambda: had() > 0.0)
        assert had() <= MAX_COUNTED_S
        had._stat = tmp_path / "stat"
        had._stat.write_text("7 (a) thread) R 1 2 3")
        until(lambda: had() == 0.0)  # computed nothing, and would like to
        assert had() == 0.0
    finally:
        wakes.set()
        thread.join()
