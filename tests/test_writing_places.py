"""Files are written through ``eitskin_proto.files.writing`` alone: whole or not at all, and never over a device.

Held by reading every module's syntax tree. What writes in another way is listed with its reason; a name that a user
gives is only among them where the command looks at it first.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("firmware_proto/eitskin_proto", "runtime", "export", "tools", "training")
DOOR = ROOT / "firmware_proto" / "eitskin_proto" / "files" / "writing.py"

OWN = "in a folder of its own, which nobody else can name or write to"

EXCEPTED = {
    "runtime/eitskin/messaging/admission/gate.py rename": "a new socket takes the name of the one before",
    "runtime/eitskin/messaging/curve_keys.py rename": "a key that was just made, to where there was none",
    "tools/eitskin_tools/bench/frame/line_floor.py save": OWN,
    "tools/eitskin_tools/bench/frame/verdicts.py savez": OWN,
    "tools/eitskin_tools/bench/peer/environment.py touch": "a mark in the environment that was just made",
    "tools/eitskin_tools/bench/skins/bench.py write_text": OWN,
    "tools/eitskin_tools/bench/skip/waking.py open": OWN,
    "tools/eitskin_tools/bench/skip/waking.py savez": OWN,
    "tools/eitskin_tools/console/closed.py open": "/dev/null, in place of a stream that was closed",
    "tools/eitskin_tools/console/closed.py os.open": "the same, and of one that takes no more",
    "tools/eitskin_tools/demo/recorder.py savez": OWN,
    "tools/eitskin_tools/demo/show.py write_text": OWN,
    "tools/eitskin_tools/emulator/board.py open": OWN,
    "tools/eitskin_tools/emulator/emulated_skin.py open": OWN,
    "tools/eitskin_tools/emulator/emulated_skin.py os.open": "the emulated board's line, a device on purpose",
    "tools/eitskin_tools/emulator/firmware.py open": "the lock of the firmware's build folder",
    "tools/eitskin_tools/fault_injection/powercut.py write_bytes": OWN,
    "tools/eitskin_tools/flash/procedure.py replace": "no file: an exchange goes on over another line",
    "tools/eitskin_tools/processes/children.py open": OWN,
    "tools/eitskin_tools/recording/sink.py os.open": "a recording grows while it is made; the file must be new",
    "tools/eitskin_tools/scans/prepare.py write_bytes": "makes a file of this source anew",
    "tools/eitskin_tools/service/watchdog.py fdopen": "memory, which has no name",
    "tools/eitskin_tools/virtual_skin/process.py open": "--log, line by line; the command looks at it first",
    "tools/eitskin_tools/virtual_skin/pty.py replace": "the link to a port, in a folder of its own",
    "tools/eitskin_tools/virtual_skin/server.py open_memmap": "--wire-times, mapped; the command looks at it first",
}
"""Module and how it writes: why it does so by itself."""

MODE = re.compile(r"[rbt]*[wax+][wax+rbt]*")
"""Of ``open``, of a file that is written."""

AT_FIRST = {"io", "os", "gzip", "bz2", "lzma", "codecs"}
"""Modules whose ``open`` takes the file before the mode, as the one without an owner does; a path's takes the mode."""

FLAGS = {"O_WRONLY", "O_RDWR", "O_CREAT", "O_APPEND", "O_TRUNC", "O_TMPFILE"}

FILE_OF = {
    "save": 0, "savez": 0, "savez_compressed": 0, "savefig": 0, "tofile": 0, "torch.save": 1, "write_table": 1,
    "save_arrays": 0,
}  # fmt: skip
"""Functions that write into a file or to a name: which argument that is."""

ALWAYS = {
    "write_bytes", "write_text", "open_memmap", "memmap", "copy2", "copyfile", "copytree", "FileHandler", "rename",
    "renames",
}  # fmt: skip


def given(names: Iterator[ast.AST]) -> set[str]:
    return {part.id for part in names if isinstance(part, ast.Name)}


def door_or_memory(tree: ast.AST) -> set[str]:
    """Return the names of files that came through the door, and of those that are in memory."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.withitem) and isinstance(node.context_expr, ast.Call) and node.optional_vars:
            source, targets = node.context_expr, [node.optional_vars]
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            source, targets = node.value, node.targets
        else:
            continue
        if getattr(source.func, "attr", getattr(source.func, "id", "")) in ("replacing", "BytesIO"):
            found |= given(part for target in targets for part in ast.walk(target))
    return found


def argument(call: ast.Call, at: int, keyword: str = "") -> ast.expr | None:
    return next((one.value for one in call.keywords if one.arg == keyword), None) or next(iter(call.args[at:]), None)


def is_written(call: ast.Call, at: int) -> bool:
    """Return whether a call of ``open`` is for writing: by its mode, or since nobody can tell it."""
    mode = argument(call, at, "mode")
    if isinstance(mode, ast.Constant):
        return isinstance(mode.value, str) and MODE.fullmatch(mode.value) is not None
    return mode is not None and at == 1


def way(call: ast.Call, safe: set[str]) -> str:
    """Return how a call writes a file by itself, or nothing.

    Args:
        call: Of whatever function.
        safe: Files that it may write into.
    """
    method = isinstance(call.func, ast.Attribute)
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    owner = getattr(getattr(call.func, "value", None), "id", "")
    if (owner, name) == ("os", "open"):
        flags = {getattr(part, "attr", getattr(part, "id", "")) for part in ast.walk(call.args[1])}
        return "os.open" if flags & FLAGS or any(one.isupper() for one in flags if one[:2] != "O_") else ""
    if name in ("open", "fdopen"):
        return name if is_written(call, 0 if method and owner not in AT_FIRST else 1) else ""
    if name == "replace":
        moves = owner == "os" or (method and len(call.args) == 1 and not call.keywords)
        return name if moves else ""
    if name == "touch":
        return name if method and not call.args else ""
    if name in ("copy", "move"):
        return name if owner == "shutil" else ""
    if name == "ZipFile":
        into = argument(call, 0, "file")
        return name if is_written(call, 1) and getattr(into, "id", "") not in safe else ""
    if (at := FILE_OF.get(f"{owner}.{name}", FILE_OF.get(name))) is not None:
        known = owner in ("np", "numpy", "torch") or name not in ("save",)
        return name if known and getattr(argument(call, at), "id", "") not in safe else ""
    return name if method and name in ALWAYS else ""


def ways(source: str) -> set[str]:
    """Return how a module writes files by itself."""
    tree = ast.parse(source)
    safe = door_or_memory(tree)
    return {found for node in ast.walk(tree) if isinstance(node, ast.Call) and (found := way(node, safe))}


def test_every_file_is_written_through_the_one_door_or_has_a_reason() -> None:
    modules = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")) if path != DOOR]
    assert len(modules) > 300
    found = {f"{path.relative_to(ROOT)} {one}" for path in modules for one in ways(path.read_text(encoding="utf-8"))}
    assert found - set(EXCEPTED) == set(), "write through eitskin_proto.files.writing"
    assert set(EXCEPTED) - found == set(), "no exceptions any more"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("open(path, 'w')", "open"),
        ("open(path, mode='ab')", "open"),
        ("open(path, mode)", "open"),
        ("with path.open('r+b') as file:\n    pass", "open"),
        ("Path(arguments.out).open('x')", "open"),
        ("os.fdopen(handle, 'wb')", "fdopen"),
        ("os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)", "os.open"),
        ("os.open(path, NEW)", "os.open"),
        ("arguments.out.write_text('x')", "write_text"),
        ("Path(arguments.out).write_bytes(b'')", "write_bytes"),
        ("np.savez(path, a=1)", "savez"),
        ("with replacing(path) as file:\n    np.savez(other, a=1)", "savez"),
        ("np.save(folder / 'x.npy', rows)", "save"),
        ("torch.save(content, path)", "save"),
        ("figure.savefig(arguments.plot, dpi=120)", "savefig"),
        ("pq.write_table(table, path)", "write_table"),
        ("zipfile.ZipFile(path, 'w')", "ZipFile"),
        ("np.lib.format.open_memmap(path, mode='w+')", "open_memmap"),
        ("shutil.copyfile(source, path)", "copyfile"),
        ("fresh.replace(path)", "replace"),
        ("os.replace(fresh, path)", "replace"),
        ("fresh.rename(path)", "rename"),
        ("path.touch()", "touch"),
    ],
)
def test_a_module_that_writes_by_itself_is_found(source: str, found: str) -> None:
    assert ways(source) == {found}


@pytest.mark.parametrize(
    "source",
    [
        "open(path)",
        "open(path, 'rb')",
        "path.open(newline='')",
        "archive.open(entry)",
        "os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)",
        "write_bytes(path, content)",
        "with suppress(OSError), replacing(path) as file:\n    np.savez(file, a=1)",
        "stream = io.BytesIO()\nnp.save(stream, rows)",
        "with replacing(path) as stream, zipfile.ZipFile(stream, 'w') as archive:\n    pass",
        "zipfile.ZipFile(stream)",
        "with replacing(path) as file:\n    torch.save(content, file)",
        "text.replace('a', 'b')",
        "moment.replace(tzinfo=UTC)",
        "replace(one, restart='always')",
        "pose.touch(touch)",
    ],
)
def test_a_module_that_reads_or_goes_through_the_door_is_not(source: str) -> None:
    assert ways(source) == set()
