"""Frames on TCP and control on ipc where few files may be open, held up in the instant before libzmq accepts on ipc.

``few_files_process.py FOLDER FILES`` prints the port of the frames. For whoever comes to control it then prints ``now``
just before the listener goes to libzmq, and waits for a line; nobody looks at TCP meanwhile. Ends when it is ended.
"""

import resource
import sys
import threading
import time

from eitskin.messaging.admission import patrol
from eitskin.messaging.admission.gate import Gate
from eitskin.messaging.control import ControlServer
from eitskin.messaging.publish import Publisher


class Controlled:
    """A runtime that has nothing to say."""

    def status(self):
        return {}


def held_up(self, most, *, first=False):
    found = listen(self, most, first=first)
    if not first:
        looking.clear()
        print("now", flush=True)
        sys.stdin.readline()
        looking.set()
    return found


looking = threading.Event()
looking.set()
folder, files = sys.argv[1], int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
listen, Gate._listen, patrol.PATROL_S = Gate._listen, held_up, 1e6
publisher = Publisher("tcp://127.0.0.1:*")
control = ControlServer(f"ipc://{folder}/c", Controlled())
print(publisher.endpoint.rpartition(":")[2], flush=True)
while True:
    looking.wait()
    publisher.look()
    publisher.look_at_connections()
    time.sleep(0.01)
