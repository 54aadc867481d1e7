"""What a served skin waits for."""

from eitskin_tools.virtual_skin import server
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for
from eitskin_tools.virtual_skin.pty import PtyPort

from ..conftest import Ramp


def test_a_skin_that_nobody_asks_anything_still_looks_for_signals_every_so_often(monkeypatch):
    """One that comes between the interpreter's last look and the wait does not end that wait."""
    waits = []

    def waited(*arguments):
        waits.append(arguments[3])
        if len(waits) == 5:
            served.stop()
        return [], [], []

    monkeypatch.setattr(server.select, "select", waited)
    with PtyPort() as port:
        served = server.SkinServer(VirtualDevice(Ramp(), configuration_for(100.0), 0), port)
        served.run()
    assert len(waits) == 5
    assert all(one is not None and one <= server.LOOK_S for one in waits)
