import json

import pytest
from tests.faults import hotplug
from tests.faults.usb_skin import missing


def test_the_stream_resumes_after_every_pulled_plug_and_nothing_leaks(capsys):
    assert hotplug.main(["--cycles", "8", "--usb-cycles", "0"]) == 0
    report = json.loads(capsys.readouterr().out)
    figures = report["hotplug"]
    assert figures["resumed"] == figures["cycles"] == 8
    assert figures["frames"] >= 8 * hotplug.FRAMES
    # Six scans at least pass while the plug is out and while hands are shaken; each is missing from the sequence.
    assert figures["lost_and_counted"] >= 8 * 5
    assert (figures["resets"], figures["leaked_descriptors"], figures["leaked_threads"]) == (0, 0, 0)
    assert "not_run" in report["usb"]


@pytest.mark.process
def test_so_it_does_on_a_mocked_usb_bus():
    lacking = missing()
    if lacking:
        pytest.skip(lacking)
    figures = hotplug.Figures(**hotplug.pull_usb(4))
    assert figures.resumed == figures.cycles == 4
    assert figures.lost_and_counted >= 4 * 5
    assert not figures.wrong
