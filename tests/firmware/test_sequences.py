"""Random requests with power cuts between and within them: the C core, the virtual skin and the emulated board."""

import os
import subprocess
from pathlib import Path

import pytest
from tests.emulator import device_core, firmware
from tests.faults import powercut
from tests.faults.requests.lines import UNASKED, CoreLine
from tests.faults.requests.search import search

from .asked import VirtualAsked

SEED = int(os.environ.get("EITSKIN_SEED", "0"))


class VirtualLine:
    """The virtual skin: its storage has no changes at which the power could fail."""

    dead, images = False, 0

    def __init__(self, seed):
        self.asked = VirtualAsked(None)

    def ask(self, packet):
        self.asked.send(b"\0" + packet)
        return [found for found in self.asked.deframer.feed(self.asked.wait(0.001)) if found[0] not in UNASKED]

    def await_restart(self):
        self.asked.wait(0.025)

    def wait(self, seconds):
        for _ in range(seconds):
            self.asked.wait(1.0)

    def boot(self):
        self.asked.power_cycle()
        self.asked.wait(0.0)

    def cut(self, change, seed):
        pass

    def outcomes(self):
        return []

    def close(self):
        pass


COMPILE = ["cc", "-std=c11", "-O1", "-fPIC", f"-I{firmware.FOLDER}/core", f"-I{firmware.FOLDER}/board"]


@pytest.fixture(scope="module")
def objects(tmp_path_factory):
    """Return the folder of the core's objects, one for each file."""
    folder = tmp_path_factory.mktemp("objects")
    sources = [*(firmware.FOLDER / "core").glob("*.c"), firmware.FOLDER / "board" / "host.c"]
    subprocess.run([*COMPILE, "-c", *map(str, sources)], cwd=folder, check=True)
    return folder


def built(folder, objects, file, right, wrong):
    """Return the core with one mistake in it."""
    text = (firmware.FOLDER / "core" / file).read_text()
    assert text.count(right) == 1, f"{file} no longer says {right!r}"
    (folder / file).write_text(text.replace(right, wrong))
    others = [str(path) for path in objects.glob("*.o") if path.stem != Path(file).stem]
    made = folder / "libeit.so"
    subprocess.run([*COMPILE, "-shared", str(folder / file), *others, "-o", str(made)], check=True)
    return device_core.load(made)


@pytest.mark.heavy
def test_whatever_is_asked_and_cut_a_confirmed_configuration_stays_bootable(core):
    found = search(CoreLine, 400, SEED)
    assert (found.breaches, found.differing) == (0, 0), found.lost
    assert found.with_confirmed > 180, "without a confirmed one there is nothing to keep"
    assert found.cuts > 180
    assert found.images > 25_000


MISTAKES = {
    "a rollback leaves the only confirmed slot to the next BEGIN":
        ("eit_store.c", "if (!slot.confirmed) {\n        return true;", "if (true) {\n        return true;"),
    "an erase that is cut short revives a revoked slot":
        ("eit_store.c", "status = program(store->port, other, EIT_SLOT_COMMIT, 0);", "status = EIT_OK;"),
    "a trial that a power cut does not end":
        ("eit_store.c", "program(port, newer, EIT_SLOT_ATTEMPT, 0) == EIT_OK", "port != 0"),
}  # fmt: skip


@pytest.mark.heavy
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_the_core_is_found_and_told_in_few_steps(core, objects, tmp_path, mistake):
    wrong = built(tmp_path, objects, *MISTAKES[mistake])
    searches = (search(lambda number: CoreLine(number, wrong), 20, seed, keep=1) for seed in range(SEED, SEED + 20))
    found = next(found for found in searches if found.lost)
    assert found.breaches + found.differing > 0
    shortest = found.lost[0].split("shortest: ")[1]
    assert shortest.count("('") <= 20, found.lost


def test_the_virtual_skin_answers_the_same_sequences_as_the_specification():
    found = search(VirtualLine, 60, SEED)
    assert (found.breaches, found.differing) == (0, 0), found.lost
    assert found.with_confirmed > 25


@pytest.mark.process
def test_the_emulated_board_that_is_killed_at_writes_boots_what_was_confirmed():
    missing = firmware.missing_tools("qemu")
    if missing:
        pytest.skip(f"{', '.join(missing)} not found: apt-get install gcc-arm-none-eabi qemu-system-arm")
    found = powercut.cut_board(3)
    assert found["lost"] == []
    assert sum(found["booted"].values()) == found["cuts"] == 4
