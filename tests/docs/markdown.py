"""What the project's Markdown files hold: their lines, links, headings and code blocks."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]

FENCE = re.compile(r"^\s*```(.*)$")
SAID = re.compile(r"eitskin [\w-]+: ")
"""How a line begins that a command says."""

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def pages():
    """Return every Markdown file of the project."""
    folders = [ROOT, ROOT / "firmware_proto"]
    return sorted([path for folder in folders for path in folder.glob("*.md")] + [*(ROOT / "docs").rglob("*.md")])


def outside_code(path: Path) -> Iterator[str]:
    """Yield the lines that are neither fenced nor indented code."""
    fenced = False
    for line in path.read_text(encoding="utf-8").splitlines():
        if FENCE.match(line):
            fenced = not fenced
        elif not fenced and not line.startswith("    "):
            yield line


def links(path: Path) -> list[str]:
    return [target for line in outside_code(path) for target in LINK.findall(line)]


def anchors(path: Path) -> set[str]:
    """Return what GitHub and MyST call the headings of a page."""
    found = set()
    for line in outside_code(path):
        if line.startswith("#"):
            text = line.lstrip("#").strip().replace("`", "").lower()
            found.add(re.sub(r"[^\w\- ]", "", text).replace(" ", "-"))
    return found


def code_blocks(path: Path, language: str) -> list[str]:
    blocks, lines, wanted = [], [], None
    for line in path.read_text(encoding="utf-8").splitlines():
        if match := FENCE.match(line):
            if wanted is None:
                wanted, lines = match.group(1).strip(), []
            else:
                if wanted == language:
                    blocks.append("\n".join(lines))
                wanted = None
        elif wanted is not None:
            lines.append(line)
    return blocks


def commands(path: Path) -> list[str]:
    """Return every ``eitskin`` command of a page: in code, where a backslash joins lines, and within backquotes."""
    found, joined, fence = [], "", None
    for line in path.read_text(encoding="utf-8").splitlines():
        if match := FENCE.match(line):
            fence, joined = match[1].strip() if fence is None else None, ""
            continue
        joined += line.strip()
        if joined.endswith("\\"):
            joined = joined.removesuffix("\\") + " "
            continue
        code = fence in ("sh", "text") if fence is not None else line.startswith("    ")
        if code and joined.startswith("eitskin ") and not SAID.match(joined):
            found.append(joined)
        joined = ""
    inline = " ".join(outside_code(path))
    return found + [text for text in re.findall(r"`(eitskin [^`]+)`", inline) if not text.startswith("eitskin <")]
