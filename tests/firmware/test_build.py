import json
import subprocess

import pytest
from tests.emulator import firmware


def test_the_core_uses_no_heap_no_stdio_and_no_globals(core, tmp_path):
    # Symbols of the core's objects: undefined ones may only be the compiler's own helpers; none may be data.
    sources = sorted((firmware.FOLDER / "core").glob("*.c"))
    assert len(sources) >= 9
    allowed = {"memcpy", "memset", "memmove", "memcmp", "_GLOBAL_OFFSET_TABLE_"}
    for source in sources:
        text = source.read_text()
        for word in ("malloc", "free(", "stdio", "printf"):
            assert word not in text, f"{source.name} uses {word}"
        made = tmp_path / f"{source.stem}.o"
        subprocess.run(["cc", "-std=c11", "-Os", "-fno-pie", "-c", str(source), "-o", str(made)], check=True)
        listed = subprocess.run(["nm", str(made)], capture_output=True, text=True, check=True)
        for line in listed.stdout.splitlines():
            kind, name = line.split()[-2:]
            assert kind not in "BbDdC", f"{source.name} keeps state in {name}"
            assert kind != "U" or name.startswith("eit_") or name in allowed, f"{source.name} needs {name}"


def test_sizes_are_measured_and_stay_small():
    if firmware.missing_tools("firmware"):
        pytest.skip(f"{', '.join(firmware.missing_tools('firmware'))} not found: apt-get install gcc-arm-none-eabi")
    firmware.build("firmware")  # holds the build folder, as `make sizes` does not; it then finds everything built
    done = subprocess.run(
        ["make", "-s", "-C", str(firmware.FOLDER), "sizes"], capture_output=True, text=True, check=True
    )
    sizes = json.loads(done.stdout.splitlines()[-1])
    # A small Cortex-M has 64 KiB of flash and 20 KiB of RAM; 16 KiB of this board's RAM are its two line buffers.
    assert 4_000 < sizes["flash_bytes"] < 24_000
    assert 16_384 < sizes["ram_bytes"] < 20_000
    assert 100 < sizes["stack_bytes"] < 2_000


def test_a_missing_compiler_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(firmware.SkinError, match="make, cc not found: apt-get install build-essential"):
        firmware.build("host")
