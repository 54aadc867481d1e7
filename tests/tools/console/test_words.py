"""Values as people read them."""

import pytest

from eitskin_tools.commands import doctor
from eitskin_tools.console.terminal import in_words


@pytest.mark.parametrize(("value", "words"), [
    (None, "none"), ("", "none"), ([], "none"), (True, "yes"), (False, "no"), (0, "0"), (0.0, "0.0"),
    (["FACTORY", "ROLLED_BACK"], "factory; rolled back"), (["port /dev/X: open"], "port /dev/X: open"),
    ([0, 2], "[0, 2]"), ("VIRTUAL-1", "VIRTUAL-1"),
])  # fmt: skip
def test_a_value_is_in_words(value, words):
    assert in_words(value) == words


def test_doctor_says_what_a_device_lacks_in_words(capsys):
    found = {"ports": [], "usb": [], "bundles": [], "runtimes": [], "limits": [], "problems": []}
    device, configuration = {"flags": ["FACTORY"], "line": ["a", "b"]}, {"skin": "", "rolls_back_to": None}
    doctor._print({**found, "device": device, "configuration": configuration})
    assert capsys.readouterr().out.splitlines() == [
        "device   flags factory", "device   line a; b", "config   skin none", "config   rolls_back_to none",
    ]  # fmt: skip
