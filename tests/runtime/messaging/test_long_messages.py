"""libzmq ends a connection that brings a message beyond the limit: the subscription comes again by itself."""

import threading

import zmq

import eitskin
from eitskin.messaging.subscriber import LARGEST_TAKEN


def test_a_message_that_is_too_long_does_not_make_a_subscription_deaf(packer, tmp_path):
    endpoint, done = f"ipc://{tmp_path}/f", threading.Event()
    packer.put_texts("vd2t", (), ())
    good = bytes(packer.message())

    def publish():
        with zmq.Context() as context, context.socket(zmq.PUB) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.bind(endpoint)
            for number in range(100_000):
                socket.send(good + bytes(LARGEST_TAKEN if number == 500 else 0))
                if done.wait(0.002):
                    break

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        with eitskin.subscribe(endpoint, mode="all", timeout_s=60) as frames:
            found = next(frame for frame in frames if frames.received > 600)
        assert found.solver == "vd2t"
    finally:
        done.set()
        thread.join()
