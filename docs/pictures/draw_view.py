"""Draw view.png: the page of ``eitskin view`` in front of the demonstration, in a headless Chromium.

Needs the extra ``dev`` and Chromium (``tools/system-packages.sh chromium``): ``python docs/pictures/draw_view.py``.
"""

import io
import re
import subprocess
import sys
import time
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "tools" / "view"))
from chromium import Browser  # noqa: E402

GOOD = """(() => {
    const shown = window.eitskin && eitskin.history.shown;
    if (!shown || eitskin.history.newest.t - eitskin.history.oldest.t < 40000) return false;
    const { radius, corners } = shown.surface;
    const z = corners.filter((_, k) => k % 3 === 2), high = Math.max(...z) - Math.min(...z);
    return shown.head.touches.length >= 2 && high > 20 && shown.head.cloud === shown.surface.revision && radius > 0;
})()"""
"""A moment worth showing: two touches on a bent sheet, and some history."""


def main() -> None:
    """Draw the page."""
    demo = subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", "demo", "--view", "--rate", "100"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert demo.stderr is not None
    try:
        address = next(found[1] for line in demo.stderr if (found := re.search(r"(http://\S+)", line)))
        with Browser(1280, 720) as page:
            page.open(address)
            end = time.monotonic() + 300
            while not page.evaluate(GOOD):
                assert time.monotonic() < end, "no moment worth showing"
            page.evaluate("document.getElementById('pause').click()")
            page.evaluate("document.activeElement.blur()")
            drawn = page.evaluate("eitskin.page.drawings")
            page.wait(f"eitskin.page.drawings > {drawn} + 2")
            picture = Image.open(io.BytesIO(page.picture())).convert("RGB")
            picture.save(Path(__file__).with_name("view.png"), optimize=True)
    finally:
        demo.terminate()
        demo.wait()


if __name__ == "__main__":
    main()
