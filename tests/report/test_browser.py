"""The pages as a browser shows them, as wide as a screen and as a phone."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from hydrabeam_mpi.report.document import write_report
from tests.report import loops
from tests.report.chains.made import new_chains
from tests.report.conftest import BULK, Edit, drop_arrays

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WIDTHS = (1280, 390)

# Put before the page's own script, so that no error escapes; the page's policy blocks and tells every request.
WATCH = """<script>
const errors = [];
addEventListener("error", event => errors.push(event.message));
addEventListener("securitypolicyviolation", event => errors.push(`request to ${event.blockedURI}`));
console.error = (...said) => errors.push(said.join(" "));
addEventListener("load", () => {
  const images = [...document.images];
  const told = {
    errors, shown: innerWidth, needed: document.documentElement.scrollWidth,
    figures: images.length, loaded: images.filter(one => one.complete && one.naturalWidth > 0).length,
    smallest: Math.min(...images.map(one => one.clientWidth)),
    requests: performance.getEntriesByType("resource").map(one => one.name).filter(one => !one.startsWith("data:")),
  };
  const head = document.querySelector("th button");
  head.click();
  head.click();
  const cells = [...head.closest("table").tBodies[0].rows].map(row => row.cells[0].textContent);
  told.sorted = [head.parentElement.ariaSort, cells];
  images[0]?.click();
  told.enlarged = document.querySelector("dialog").open;
  dispatchEvent(new Event("beforeprint"));
  told.closed = document.querySelectorAll("details:not([open])").length;
  parent.postMessage(told, "*");
});
</script>"""
FRAMES = """<!DOCTYPE html><script>
const told = {{}};
addEventListener("message", event => {{
  told[event.data.shown] = event.data;
  document.querySelector("pre").textContent = JSON.stringify(told);
}});
</script><pre></pre>{frames}"""


def shown(page: Path, folder: Path) -> dict[int, dict[str, Any]]:
    """What a browser tells of a page, by its width."""
    assert CHROMIUM is not None
    (folder / "page.html").write_text(page.read_text().replace("<title>", f"{WATCH}<title>", 1))
    frames = "".join(
        f'<iframe src="page.html" width="{width}" height="800" frameborder="0"></iframe>' for width in WIDTHS
    )
    (folder / "frames.html").write_text(FRAMES.format(frames=frames))
    options = "--no-sandbox --headless --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    command = [CHROMIUM, *options.split(), f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=10000"]
    done = subprocess.run([*command, "--dump-dom", (folder / "frames.html").as_uri()], capture_output=True, timeout=300)
    found = re.search(r"<pre>(.*?)</pre>", done.stdout.decode(), re.DOTALL)
    assert found, done.stderr.decode()
    return {int(width): told for width, told in json.loads(unescape(found[1])).items()}


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here to open the page with")
@pytest.mark.parametrize("kind", ["posterior", "channels", "loop", "chains"])
def test_the_page_works_on_screen_and_phone(
    kind: str, request: pytest.FixtureRequest, edited: Edit, tmp_path: Path
) -> None:
    if kind == "chains":
        folder = tmp_path / "chains"
        new_chains(folder, n_chains=2, n_draws=200)
        write_report(folder)
    elif kind == "loop":
        folder = edited(request.getfixturevalue("paper"), lambda summary: None)
        drop_arrays(folder, *BULK)
        (folder / "loop.json").write_text(json.dumps(loops.unexplained()))
        write_report(folder)
    else:
        folder = request.getfixturevalue({"posterior": "paper", "channels": "bands"}[kind])
    told = shown(folder / "report.html", tmp_path)
    assert sorted(told) == sorted(WIDTHS)
    for width, one in told.items():
        assert one["errors"] == one["requests"] == []
        assert one["needed"] <= width
        assert one["loaded"] == one["figures"] > 0
        assert one["smallest"] >= 600  # 9 pt in figures of 7.6 inches are 10 px then
        direction, cells = one["sorted"]
        assert direction == "descending"
        assert cells == sorted(cells, key=lambda text: (text.replace(",", "").isdigit(), text), reverse=True)
        assert one["enlarged"]
        assert one["closed"] == 0
