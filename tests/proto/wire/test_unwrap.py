from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin_proto.wire.frames import MODULUS, StreamCounter


@given(
    st.integers(0, MODULUS - 1),
    st.integers(0, MODULUS - 1),
    st.lists(st.tuples(st.integers(1, 900_000), st.integers(0, MODULUS - 1)), min_size=1, max_size=50),
)
@settings(max_examples=200, deadline=None)
def test_unwrapped_counters_equal_the_true_ones_over_any_wrap(first, first_us, moves):
    counter = StreamCounter()
    counter.step(first, first_us)
    sequence, device_us, lost = first, first_us, 0
    for forward, elapsed_us in moves:
        sequence, device_us, lost = sequence + forward, device_us + elapsed_us, lost + forward - 1
        step = counter.step(sequence % MODULUS, device_us % MODULUS)
        assert (step.sequence, step.device_us, step.lost) == (sequence, device_us, forward - 1)
        assert not step.reset
        assert not step.duplicate
    assert counter.lost == lost


def test_a_sequence_that_falls_back_is_a_reset_and_counts_no_loss():
    counter = StreamCounter()
    for sequence in (500, 501, 502):
        counter.step(sequence, sequence * 5000)
    step = counter.step(0, 4000)
    assert (step.reset, step.lost, step.sequence, step.device_us) == (True, 0, 0, 4000)
    assert (counter.resets, counter.lost) == (1, 0)
    assert counter.step(1, 9000).lost == 0


def test_a_reset_shortly_before_the_wrap_is_not_taken_for_a_wrap():
    counter = StreamCounter()
    counter.step(MODULUS - 2_000_000, 0)
    assert counter.step(0, 10).reset
    near = StreamCounter()
    near.step(MODULUS - 1, 0)
    assert near.step(0, 5000).lost == 0


def test_a_gap_of_the_largest_size_is_loss_and_one_more_is_a_reset():
    for lost, reset in ((100, False), (101, True)):
        counter = StreamCounter(max_lost=100)
        counter.step(7, 0)
        step = counter.step(8 + lost, 1)
        assert (step.reset, step.lost) == (reset, 0 if reset else lost)


def test_the_same_frame_twice_is_a_duplicate_that_changes_nothing():
    counter = StreamCounter()
    counter.step(3, 100)
    for device_us in (100, 999):
        step = counter.step(3, device_us)
        assert (step.duplicate, step.device_us, step.lost) == (True, 100, 0)
    assert counter.step(4, 200).device_us == 200


def test_the_same_number_at_an_earlier_time_is_a_reset():
    counter = StreamCounter()
    counter.step(0, 900_000_000)  # the device starts anew before it sends another one
    step = counter.step(0, 5_000)
    assert (step.reset, step.duplicate, step.sequence, step.device_us) == (True, False, 0, 5_000)
    assert counter.step(1, 10_000).device_us == 10_000


def test_restart_forgets_the_last_frame_but_keeps_the_counts():
    counter = StreamCounter()
    counter.step(1, 0)
    counter.step(5, 0)
    counter.restart()
    assert counter.step(1000, 3).lost == 0
    assert counter.lost == 3
