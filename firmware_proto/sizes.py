"""Prints flash, RAM and the deepest stack of the firmware, as one line of text and one JSON object.

``python3 sizes.py FILE.elf BUILD_FOLDER PREFIX``. The stack is the deepest chain of calls in GCC's call graph (``.ci``
files); a call through a pointer is taken to reach the deepest function of the board that is only ever called so.
"""

import json
import re
import subprocess
import sys
from pathlib import Path


def stack_bytes(folder: Path) -> int:
    """Return the deepest chain from ``reset`` plus that of the deepest interrupt."""
    frame: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for file in folder.glob("*.ci"):
        for title, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', file.read_text()):
            size = re.search(r"(\d+) bytes \(static\)", label)
            if size:
                frame[title] = int(size[1])
        for source, target in re.findall(r'sourcename: "([^"]+)" targetname: "([^"]+)"', file.read_text()):
            calls.setdefault(source, set()).add(target)
    called = {target for targets in calls.values() for target in targets}
    handlers = [name for name in frame if name.split(":")[-1].startswith("on_")]
    through_pointer = [name for name in frame if name not in called and name not in handlers and name != "reset"]

    def depth(name: str, above: tuple[str, ...] = ()) -> int:
        if name in above:
            raise RecursionError(f"{name} calls itself: the stack has no bound")
        targets = calls.get(name, set())
        if name == "__indirect_call":
            targets = set(through_pointer)
        return frame.get(name, 0) + max((depth(target, (*above, name)) for target in targets), default=0)

    return depth("reset") + 32 + max((depth(name) for name in handlers), default=0)  # 32: what an exception pushes


def main() -> int:
    """Print the sizes."""
    elf, folder, prefix = sys.argv[1:4]
    line = subprocess.run([f"{prefix}size", elf], capture_output=True, text=True, check=True).stdout.splitlines()[1]
    text, data, bss = (int(word) for word in line.split()[:3])
    sizes = {"flash_bytes": text + data, "ram_bytes": data + bss, "stack_bytes": stack_bytes(Path(folder))}
    print("firmware: " + ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in sizes.items()))
    print(json.dumps(sizes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
