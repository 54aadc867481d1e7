import json

from eitskin_tools.faults import hotplug


def test_the_stream_resumes_after_every_pulled_plug_and_nothing_leaks(capsys):
    assert hotplug.main(["--cycles", "8"]) == 0
    figures = json.loads(capsys.readouterr().out)["hotplug"]
    assert figures["resumed"] == figures["cycles"] == 8
    assert figures["frames"] >= 8 * hotplug.FRAMES
    # Six scans at least pass while the plug is out and while hands are shaken; each is missing from the sequence.
    assert figures["lost_and_counted"] >= 8 * 5
    assert (figures["resets"], figures["leaked_descriptors"], figures["leaked_threads"]) == (0, 0, 0)


def test_a_stream_that_does_not_resume_is_reported(monkeypatch, capsys):
    monkeypatch.setattr(hotplug, "_greet", lambda skin: False)
    assert hotplug.main(["--cycles", "2"]) == 1
    assert json.loads(capsys.readouterr().out)["hotplug"]["resumed"] == 0
